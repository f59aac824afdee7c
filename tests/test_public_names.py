"""Every room states what others may use, and everything it states exists."""

import ast
import subprocess
import sys
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


OF_MODULES = [
    "talc",
    "drivers",
    "simulators",
    "simulators.linuxcnc",
    *(r for r in ROOMS if r.startswith("gateway.cli.")),
]
"""Rooms that name modules."""


@pytest.mark.parametrize("room", OF_MODULES)
def test_a_room_that_names_modules_names_each_that_is_for_others(room: str) -> None:
    """Every module must be named or protected by the import linter."""
    protected = (ROOT / "pyproject.toml").read_text("utf-8")
    folder = ROOT / room.replace(".", "/")
    inside = {file.stem for file in folder.glob("*.py")} | {file.parent.name for file in folder.glob("*/__init__.py")}
    stated = set(import_module(room).__all__)
    undecided = {n for n in inside - stated if not n.startswith("_") and f'"{room}.{n}"' not in protected}
    assert not undecided


def _lazy(room: str) -> tuple[set[tuple[str, str]], set[tuple[str, str]]]:
    """Module and name of what a room imports for the type checker, and of what it imports on first use."""
    tree = ast.parse((ROOT / room.replace(".", "/") / "__init__.py").read_text("utf-8"))
    stated, used = set[tuple[str, str]](), set[tuple[str, str]]()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.partition(".")[0] == room.partition(".")[0]:
            for alias in node.names:
                whole = node.module == room
                stated.add((f"{node.module}.{alias.name}", "") if whole else (node.module, alias.name))
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "on_first_use":
            modules: dict[str, tuple[str, ...]] = ast.literal_eval(node.args[1])
            for module, names in modules.items():
                where = room + module if module.startswith(".") else module
                used |= {(where, name) for name in names or ("",)}
    return stated - {("drivers.first_use", "on_first_use")}, used


LAZY = [room for room in ROOMS if _lazy(room)[1]]


@pytest.mark.parametrize("room", LAZY)
def test_a_room_imports_on_first_use_what_the_type_checker_sees(room: str) -> None:
    stated, used = _lazy(room)
    assert stated == used
    assert {name or module.rpartition(".")[2] for module, name in used} == set(import_module(room).__all__)


def test_importing_a_room_imports_none_of_its_modules() -> None:
    """Except those that all rooms share."""
    code = f"import sys; from importlib import import_module; list(map(import_module, {LAZY!r})); print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    own = {name for name in done.stdout.split() if name.partition(".")[0] in ("talc", "drivers", "gateway")}
    assert len(LAZY) > 25
    assert own == {"drivers", "gateway", "drivers.first_use", *LAZY}


def by_a_private_path(source: str, file: Path) -> list[str]:
    """Names that a test imports from a module although the module's room states them. file: below tests.

    The tests in the folder that mirrors the room may: they test its modules one by one.
    """
    found = []
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.ImportFrom) or node.level or not node.module or node.module in ROOMS:
            continue
        room = max((room for room in ROOMS if node.module.startswith(f"{room}.")), key=len, default="")
        if not room or file.is_relative_to(room.replace(".", "/")):
            continue
        stated = import_module(room).__all__
        if node.module.removeprefix(f"{room}.").partition(".")[0] not in stated:
            found += [f"{node.module}.{alias.name}" for alias in node.names if alias.name in stated]
    return found


def test_a_test_imports_what_a_room_states_from_the_room() -> None:
    """Otherwise a module cannot be divided or renamed without a change of the tests of other rooms."""
    files = sorted((ROOT / "tests").rglob("*.py"))
    found = {
        file: by_a_private_path((ROOT / "tests" / file).read_text("utf-8"), file)
        for file in (path.relative_to(ROOT / "tests") for path in files)
    }
    assert len(found) > 400
    assert {str(file): names for file, names in found.items() if names} == {}


@pytest.mark.parametrize(
    ("source", "file", "found"),
    [
        ("from gateway.acquisition.line import Line", "benches/x.py", ["gateway.acquisition.line.Line"]),
        ("def f():\n    from drivers.modbus.bus import ModbusBus as B", "x.py", ["drivers.modbus.bus.ModbusBus"]),
        ("from gateway.acquisition.line import Line", "gateway/acquisition/test_x.py", []),
        ("from gateway.acquisition import Line", "benches/x.py", []),
        ("from gateway.storage.readings import Channels", "benches/x.py", []),  # not stated
        ("from talc.frame import Frame", "benches/x.py", []),  # a module that the room states
    ],
)
def test_a_private_path_is_found(source: str, file: str, found: list[str]) -> None:
    assert by_a_private_path(source, Path(file)) == found
