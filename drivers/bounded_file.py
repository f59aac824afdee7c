"""Files from outside, read within bounds: a FIFO gives nothing to wait for, and no file takes all memory."""

import errno
import os
import stat
from pathlib import Path

MOST_BYTES = 2**18
"""Of a file that people write: a configuration of 500 channels has a third of that."""


def bytes_of(path: Path, most: int = MOST_BYTES) -> bytes:
    """The content of a regular file. Raises OSError, also for one of more than `most` bytes."""
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    with os.fdopen(descriptor, "rb") as file:
        if not stat.S_ISREG(mode := os.fstat(descriptor).st_mode):
            code = errno.EISDIR if stat.S_ISDIR(mode) else errno.EINVAL
            why = os.strerror(code) if code == errno.EISDIR else "is a pipe or a device, not a file"
            raise OSError(code, why, str(path))
        content = file.read(most + 1)
    if len(content) > most:
        raise OSError(errno.EFBIG, f"is larger than {most // 1024} KiB", str(path))
    return content
