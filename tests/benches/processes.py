"""Facts that the system reports about processes under test: their children, and what they keep open."""

import os
from contextlib import suppress
from pathlib import Path

_RESOURCE_TRACKER = b"from multiprocessing.resource_tracker import main"
"""Python starts it with the first pool that spawns, one for each process, and ends it with that."""


def children(of: int) -> list[int]:
    """Live child processes of this process, without Python's resource tracker."""
    found = []
    for task in Path(f"/proc/{of}/task").iterdir():
        found += [int(pid) for pid in read_if_there(task / "children").split()]
    return [pid for pid in found if _RESOURCE_TRACKER not in read_if_there(Path(f"/proc/{pid}/cmdline"))]


def is_alive(pid: int) -> bool:
    """Whether this process runs; one that only its parent has not yet taken notice of does not."""
    status = read_if_there(Path(f"/proc/{pid}/stat")).rpartition(b")")[2].split()
    return bool(status) and status[0] != b"Z"


def open_links() -> list[str]:
    """What this process keeps open: files, sockets, terminals. Other threads may close them meanwhile."""
    found = []
    for number in os.listdir("/proc/self/fd"):  # noqa: PTH208 - twice a test: paths would double its time
        with suppress(FileNotFoundError):  # always so for the list itself
            found.append(os.readlink(f"/proc/self/fd/{number}"))  # noqa: PTH115
    return found


def read_if_there(path: Path) -> bytes:
    """The content of this file of a process or thread; empty if that has ended since it was listed."""
    try:
        return path.read_bytes()
    except (FileNotFoundError, ProcessLookupError):
        return b""
