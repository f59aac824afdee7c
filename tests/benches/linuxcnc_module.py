"""Loads modules from files outside any package: those of the control and of the examples."""

import importlib.util
from pathlib import Path
from typing import Any

from simulators.linuxcnc.machine import FILES


def linuxcnc_module(name: str) -> Any:
    """The module of that name in deploy/nc/linuxcnc; only for those that import nothing of LinuxCNC."""
    return module_at(FILES / f"{name}.py")


def module_at(path: Path) -> Any:
    """The module in a file, loaded again."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
