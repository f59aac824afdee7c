"""Files from outside, read within bounds: a FIFO gives nothing to wait for, and no file takes all memory."""

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO

from drivers.text import Text

MOST_BYTES = 2**18
"""Of a file that people write: a configuration of 500 channels has a third of that."""
MOST_CERTIFICATES = 2**22
"""Of a file of certificates; the authorities that an operating system trusts have a tenth of that."""


def bytes_of(path: Path, most: int = MOST_BYTES) -> bytes:
    """The content of a regular file. Raises OSError, also for one of more than `most` bytes."""
    with opened(path) as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise OSError(errno.EFBIG, Text("file_too_large", most_kib=most // 1024), str(path))
    return content


def check_bounds(*paths: Path | None, most: int = MOST_CERTIFICATES) -> None:
    """For files that a library reads by itself. Raises OSError, as `bytes_of`."""
    for path in paths:
        if path is not None:
            bytes_of(path, most)


def opened(path: Path) -> BinaryIO:
    """A regular file, for reading. Raises OSError."""
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        if not stat.S_ISREG(mode := os.fstat(descriptor).st_mode):
            code = errno.EISDIR if stat.S_ISDIR(mode) else errno.EINVAL
            raise OSError(code, os.strerror(code) if code == errno.EISDIR else Text("file_no_file"), str(path))
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise
