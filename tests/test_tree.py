"""The tree is easy to search: README.md names every room, the tests mirror the rooms and their modules, tests/README.md
names the rest."""

import ast
import re
from collections.abc import Iterable
from functools import cache
from pathlib import Path

import pytest

TESTS = Path(__file__).parent
ROOT = TESTS.parent
TOPS = ("benchmarks", "drivers", "gateway", "simulators", "studies", "talc")
MODULES = {
    ".".join(file.relative_to(ROOT).with_suffix("").parts): file
    for top in ("drivers", "gateway", "talc")
    for file in (ROOT / top).rglob("*.py")
}
INIT = ".__init__"
PROGRAM = "gateway.cli"
"""Its folders count as one room of modules: a test calls a command, and `main` names or imports the module."""


def room_of(module: str) -> str:
    return PROGRAM if module.startswith(f"{PROGRAM}.") else module.rpartition(".")[0]


@cache
def named(file: Path) -> frozenset[str]:
    """What a file imports, as `module.name`, and the modules that its texts name, as those of commands."""
    found = set[str]()
    for node in ast.walk(ast.parse(file.read_text("utf-8"))):
        match node:
            case ast.ImportFrom(module=str(module), names=names):
                found |= {f"{module}.{alias.name}" for alias in names}
            case ast.Import(names=names):
                found |= {alias.name for alias in names}
            case ast.Constant(value=str(text)) if text in MODULES:
                found.add(text)
    return frozenset(found)


def shown_by_rooms() -> dict[str, str]:
    """What rooms show of their modules: `room.name`, and where it is."""
    inits = {module.removesuffix(INIT): file for module, file in MODULES.items() if module.endswith(INIT)}
    return {f"{room}.{name.rpartition('.')[2]}": name for room, file in inits.items() for name in named(file)}


def modules_of(names: Iterable[str], shown: dict[str, str]) -> set[str]:
    """The modules that these imports use."""
    found = set()
    for name in names:
        while shown.get(name, name) != name:
            name = shown[name]
        found.add(name if name in MODULES else name.rpartition(".")[0])
    return found


def reached(tests: Iterable[Path], room: set[str], shown: dict[str, str]) -> set[str]:
    """Modules of a room that these tests import, by the room or not, and those of the room that these import."""
    found, new = set[str](), modules_of({name for file in tests for name in named(file)}, shown) & room
    while new:
        found |= new
        new = (modules_of({name for module in new for name in named(MODULES[module])}, shown) & room) - found
    return found


def index() -> dict[str, list[str]]:
    """By module, the tests that tests/README.md names for it."""
    text = (TESTS / "README.md").read_text("utf-8")
    rows = text.partition("## From a module to its tests\n")[2].partition("\n## ")[0].splitlines()
    cells = [
        [re.findall(r"`([\w/]+\.py)`", cell) for cell in row.split("|")[1:3]] for row in rows if row.startswith("|")
    ]
    return {module.removesuffix(".py").replace("/", "."): tests for modules, tests in cells for module in modules}


def test_every_room_has_a_folder_of_tests() -> None:
    rooms = [file.parent.relative_to(ROOT) for top in TOPS for file in (ROOT / top).rglob("__init__.py")]
    assert len(rooms) > 40, "the rooms were found"
    assert [str(room) for room in rooms if not list((TESTS / room).rglob("test_*.py"))] == []


def test_every_other_folder_of_tests_is_in_the_index() -> None:
    index = (TESTS / "README.md").read_text("utf-8")
    folders = {file.parent for file in TESTS.rglob("test_*.py")} - {TESTS}
    others = [folder.relative_to(ROOT) for folder in folders if not (ROOT / folder.relative_to(TESTS)).is_dir()]
    assert others, "tests/gateway/faults is one"
    assert [str(folder) for folder in others if str(folder) not in index] == []


@pytest.mark.parametrize("room", sorted({room_of(module) for module in MODULES}))
def test_every_module_is_tested_in_the_folder_of_its_room_or_is_in_the_index(room: str) -> None:
    modules = {module for module in MODULES if room_of(module) == room and not module.endswith("__")}
    folder = TESTS / room.replace(".", "/")
    tests = list(folder.rglob("test_*.py") if room == PROGRAM else folder.glob("test_*.py"))
    assert sorted(modules - reached(tests, modules, shown_by_rooms()) - set(index())) == []


def test_what_the_index_names_is_there() -> None:
    assert len(index()) > 30, "the table was found"
    assert [module for module in index() if module not in MODULES] == []
    assert [test for tests in index().values() for test in tests if not (ROOT / test).is_file()] == []
    assert all(index().values())


def test_the_readme_names_every_room_of_drivers_and_gateway() -> None:
    readme = (ROOT / "README.md").read_text("utf-8")
    house = readme[readme.index("## The house") :]
    rooms = [file.parent.name for top in ("drivers", "gateway") for file in (ROOT / top).glob("*/__init__.py")]
    assert len(rooms) > 25, "the rooms were found"
    assert [room for room in rooms if f"`{room}/`" not in house] == []


def test_a_long_file_states_its_reason() -> None:
    """More than 400 lines are two responsibilities, unless the first lines say why not."""
    files = [
        file
        for top in (*TOPS, "deploy", "examples", "tests")
        for ending in ("py", "cpp", "hpp", "cc", "js", "sh", "toml")
        for file in (ROOT / top).rglob(f"*.{ending}")
        if "node_modules" not in file.parts
    ]
    assert len(files) > 500, "the rooms were found"
    long = {file: text for file in files if (text := file.read_text("utf-8")).count("\n") > 400}
    assert [
        str(f.relative_to(ROOT)) for f, text in long.items() if "longer than 400 lines" not in text[:500].lower()
    ] == []
