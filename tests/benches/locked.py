"""The packages that a lock of requirements/ installs."""

from pathlib import Path

from packaging.requirements import Requirement


def locked(lock: Path, python: str) -> set[str]:
    """NAME==VERSION of everything that the lock installs for this Python, such as 3.11, on this kind of computer."""
    lines = lock.read_text(encoding="utf-8").splitlines()
    wanted = [Requirement(line.rstrip("\\ ")) for line in lines if "==" in line and line[0] not in " #"]
    here = {"python_version": python, "python_full_version": f"{python}.0"}
    return {f"{one.name}{one.specifier}" for one in wanted if one.marker is None or one.marker.evaluate(here)}
