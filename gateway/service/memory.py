"""Memory and descriptors of the process: large blocks go back to the computer, and strangers leave enough for the
devices."""

import ctypes
import resource

_M_MMAP_THRESHOLD = -3
"""From the GNU C library's malloc.h."""
_BLOCK_BYTES = 128 * 1024
"""The library's own value at the start of a process (mallopt(3))."""

_DESCRIPTORS = 65536
"""Strangers hold at most some 1,100 in the end. Zenoh ends silent connections one after the other, some 200 a second:
until then they hold as many as came, and one address may open 28,000."""


def give_back_large_blocks() -> None:
    """From now on, a large block goes back to the computer as soon as it is freed.

    The GNU C library raises its limit to the largest block that was ever freed, up to 32 MB. A snapshot of the
    controller, of several such blocks, then leaves holes of more than 100 MB that no other use fills. With another C
    library nothing is done.
    """
    if (mallopt := getattr(ctypes.CDLL(None), "mallopt", None)) is not None:
        mallopt(_M_MMAP_THRESHOLD, _BLOCK_BYTES)


def raise_descriptors() -> None:
    """Let the process open as many files and connections as its limits allow; the usual 1024 are few for it."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    most = _DESCRIPTORS if hard == resource.RLIM_INFINITY else min(_DESCRIPTORS, hard)
    if soft != resource.RLIM_INFINITY and soft < most:
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))
