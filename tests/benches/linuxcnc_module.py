"""Modules of the agent on LinuxCNC, which are files of the control and in no package."""

import importlib.util
from typing import Any

from simulators.linuxcnc.machine import FILES


def linuxcnc_module(name: str) -> Any:
    """The module of that name in deploy/nc/linuxcnc; only for those that import nothing of LinuxCNC."""
    spec = importlib.util.spec_from_file_location(name, FILES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
