"""Files that change as a whole: a reader, and a power cut, find what was there before or what is there now."""

import errno
import os
from contextlib import suppress
from pathlib import Path
from shutil import copystat


def write_whole(path: Path, content: str | bytes, *, before: Path | None = None) -> None:
    """Write a file, or exchange it for another one of the same owner and mode; it is on the disk when this returns.

    Parameters
    ----------
    content: text is written as UTF-8, with its ends of lines as they are
    before: where what is there now goes, in the same folder

    Raises OSError; `path` is as it was then, or at `before`.
    """
    target = path.resolve()  # a link stays one
    part = target.with_name(target.name + ".part")
    try:
        with part.open("wb") as file:
            _like(target, part)
            file.write(content.encode() if isinstance(content, str) else content)
            file.flush()
            os.fsync(file.fileno())
        os.utime(part)
        if before is not None:
            with suppress(FileNotFoundError):
                target.replace(before)
        part.replace(target)
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)
    sync_folder(target.parent)


def _like(target: Path, part: Path) -> None:
    """Give the file the owner, the mode and the access list of another one, if there is one."""
    with suppress(FileNotFoundError):
        owned = target.stat()
        os.chown(part, owned.st_uid, owned.st_gid)
        copystat(target, part)


def sync_folder(folder: Path) -> None:
    """Make the names in a folder durable. Raises OSError."""
    number = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(number)
    except OSError as error:
        if error.errno != errno.EINVAL:  # a file system that knows no such thing
            raise
    finally:
        os.close(number)
