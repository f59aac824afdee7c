"""The lock that keeps a second gateway off a database."""

import errno
import fcntl
import hashlib
import os
import socket
from contextlib import suppress
from pathlib import Path

from gateway.storage.faults import StoreError


def link_followed(path: Path) -> Path:
    """The file that a symbolic link leads to: one database has one lock, whatever name leads to it, and what is set
    aside or started again is on the disk where it is.

    Raises StoreError for a link to a folder that is not there, such as a folder on a disk that is not mounted.
    """
    if not path.is_symlink():
        return path
    try:
        target = Path(os.path.realpath(path))
        if target.parent.is_dir() and not target.is_symlink():
            return target
    except OSError:  # links that lead in a circle
        pass
    raise StoreError(f"{path}: is a link to {path.readlink()}, which cannot be reached; is its disk mounted?")


class FileLock:
    """Lock of the single gateway that writes to a database; the kernel releases it when the process ends in any way.

    A lock on a file beside the database also holds between containers, but goes when someone deletes the database with
    all that is beside it. A name in the kernel (an abstract socket) cannot be deleted.

    Raises StoreError if another process holds it, or if its file cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self._lock_path = path.with_name(path.name + ".lock")
        self._name = _taken_name(path)
        try:
            self._lock_file(path)
        except StoreError:
            self._name.close()
            raise

    def _lock_file(self, path: Path) -> None:
        while True:
            try:
                # A link that somebody put there would lead to a file of anybody's.
                flags = os.O_WRONLY | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK
                self._file = os.fdopen(os.open(self._lock_path, flags, 0o666), "w")
            except OSError as error:
                if error.errno == errno.ELOOP:
                    raise StoreError(f"{self._lock_path}: is a symbolic link; remove it") from error
                raise StoreError(f"{path}: cannot be written: {error.strerror}") from error
            try:
                fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                self._file.close()
                raise _held(path) from None
            # The previous holder may have removed the file between our opening and locking it.
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(self._file.fileno()), self._lock_path.stat()):
                    return
            self._file.close()

    def release(self) -> None:
        """Remove the lock's file and release it. A process that waits for it detects that and makes a new one."""
        with suppress(OSError):  # on a disk that fails the file stays; it locks nobody out
            self._lock_path.unlink(missing_ok=True)
        self._file.close()
        self._name.close()


def _taken_name(path: Path) -> socket.socket:
    folder = path.parent.stat()
    which = hashlib.sha256(f"{folder.st_dev} {folder.st_ino} {path.name}".encode()).hexdigest()
    name = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        name.bind(f"\0talc-gateway-{which}")
    except OSError as error:
        name.close()
        if error.errno == errno.EADDRINUSE:
            raise _held(path) from None
        raise StoreError(f"{path}: cannot be locked: {error.strerror}") from error
    return name


def _held(path: Path) -> StoreError:
    return StoreError(f"{path}: another gateway writes to it; stop it or give [storage] another path")
