"""Every room states what others may use, and what it states is there."""

from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ROOMS = sorted(
    ".".join(file.relative_to(ROOT).parent.parts)
    for top in ("talc", "drivers", "gateway", "simulators", "studies", "benchmarks")
    for file in (ROOT / top).rglob("__init__.py")
)


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_states_its_public_names(room: str) -> None:
    module = import_module(room)
    assert isinstance(module.__all__, list)
    missing = [n for n in module.__all__ if not hasattr(module, n) and find_spec(f"{room}.{n}") is None]
    assert not missing


@pytest.mark.parametrize("room", ["talc", "drivers", "simulators", "simulators.linuxcnc"])
def test_a_room_that_names_modules_names_each_that_is_for_others(room: str) -> None:
    """Every module must be named or protected by the import linter."""
    protected = (ROOT / "pyproject.toml").read_text("utf-8")
    folder = ROOT / room.replace(".", "/")
    inside = {file.stem for file in folder.glob("*.py")} | {file.parent.name for file in folder.glob("*/__init__.py")}
    stated = set(import_module(room).__all__)
    undecided = {n for n in inside - stated if not n.startswith("_") and f'"{room}.{n}"' not in protected}
    assert not undecided
