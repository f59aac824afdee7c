"""Every room states what others may use, and what it states is there."""

import tomllib
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest

import talc

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


def test_completion_offers_what_talc_imports_when_it_is_first_used() -> None:
    """In a notebook, `talc.` and the tabulator key are how one finds `Learner`."""
    assert set(talc.__all__) <= set(dir(talc))


def test_the_import_linter_knows_every_room() -> None:
    """A room without a contract would be open to everybody, and nobody would notice."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["importlinter"]["contracts"]
    protected = {name for c in contracts if c["type"] == "protected" for name in c["protected_modules"]}
    inside = [room for room in ROOMS if "." in room]
    assert len(inside) > 30, "the rooms were found"
    openly = [
        room
        for room in inside
        if not {room, f"{room}.*", f"{room.rpartition('.')[0]}.*"} & protected
        and not any(name.startswith(f"{room}.") for name in protected)  # module by module, see the next test
    ]
    assert openly == []


@pytest.mark.parametrize("room", ["talc", "drivers", "simulators", "simulators.linuxcnc"])
def test_a_room_that_names_modules_names_each_that_is_for_others(room: str) -> None:
    """Every module must be named or protected by the import linter."""
    protected = (ROOT / "pyproject.toml").read_text("utf-8")
    folder = ROOT / room.replace(".", "/")
    inside = {file.stem for file in folder.glob("*.py")} | {file.parent.name for file in folder.glob("*/__init__.py")}
    stated = set(import_module(room).__all__)
    undecided = {n for n in inside - stated if not n.startswith("_") and f'"{room}.{n}"' not in protected}
    assert not undecided
