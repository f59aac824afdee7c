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


@pytest.mark.parametrize("room", ["talc", "drivers", "simulators", "simulators.linuxcnc"])
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
