"""Memory of the process: large blocks go back to the computer, and garbage collections spare what lasts."""

import ctypes
import gc

_M_MMAP_THRESHOLD = -3
"""From the GNU C library's malloc.h."""
_BLOCK_BYTES = 128 * 1024
"""The library's own value at the start of a process (mallopt(3))."""


def give_back_large_blocks() -> None:
    """From now on, a large block goes back to the computer as soon as it is freed.

    The GNU C library raises its limit to the largest block that was ever freed, up to 32 MB. A snapshot of the
    controller, of several such blocks, then leaves holes of more than 100 MB that no other use fills. With another C
    library nothing is done.
    """
    if (mallopt := getattr(ctypes.CDLL(None), "mallopt", None)) is not None:
        mallopt(_M_MMAP_THRESHOLD, _BLOCK_BYTES)


def freeze_gc() -> None:
    """Exempt what exists now from garbage collections: modules and settings, nearly all of which last as long as the
    process.

    With 500 channels, a full collection stopped the event loop for 30 ms, and a period of every bus was late.
    """
    gc.collect()
    gc.freeze()
