"""Child processes of a process under test."""

from pathlib import Path

_RESOURCE_TRACKER = b"from multiprocessing.resource_tracker import main"
"""Python starts it with the first pool that spawns, one for each process, and ends it with that."""


def children(of: int) -> list[int]:
    """Live child processes of this process, without Python's resource tracker."""
    found = []
    for task in Path(f"/proc/{of}/task").iterdir():
        found += [int(pid) for pid in (task / "children").read_text(encoding="ascii").split()]
    return [pid for pid in found if not _is_resource_tracker(pid)]


def _is_resource_tracker(pid: int) -> bool:
    try:
        return _RESOURCE_TRACKER in Path(f"/proc/{pid}/cmdline").read_bytes()
    except (FileNotFoundError, ProcessLookupError):  # it has just ended
        return False
