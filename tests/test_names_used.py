"""Somebody outside a room uses each name that the room states, or a reason is given here.

What is stated is a promise to users of the packages (CHANGELOG.md), and cannot be renamed without a line there. Tests
of the room itself are not outside: they import from its modules. A room within another is a room of its own.
"""

import ast
import re
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
STATING = ("talc", "drivers", "gateway", "simulators")
"""The other two, benchmarks and studies, are programs, which nothing imports."""
USING = (*STATING, "benchmarks", "studies", "tests", "examples", "deploy")
ROOMS = sorted(
    ".".join(file.relative_to(ROOT).parent.parts) for top in STATING for file in (ROOT / top).rglob("__init__.py")
)
REASONS = {
    "gateway.collect.CollectError": "what a site raises; the command line handles it as any OSError",
    "gateway.telemetry.CommandRequest": "a message, as all that docs/telemetry has a schema of",
    "gateway.telemetry.SignedCommand": "what CommandSigner returns, for programs that send it themselves",
    "simulators.plant.Ageing": "an argument of Plant, for tests outside (docs/plant.md)",
}
"""Why a name is stated although nobody here uses it."""
DOTTED = re.compile(rf"\b(?:{'|'.join(STATING)})(?:\.\w+)+")
IMPORT = re.compile(rf"\bfrom ((?:{'|'.join(STATING)})(?:\.\w+)*) import ([\w, ]+)")


def used_by_code(source: str) -> set[str]:
    """Dotted names that Python code imports, takes from a module it has imported, or has as values in a table.

    The tables are of what is imported later, such as the commands in `gateway/cli/main.py`.
    """
    found = set[str]()
    local = dict[str, str]()
    nodes = list(ast.walk(ast.parse(source)))
    for node in nodes:
        if isinstance(node, ast.ImportFrom) and node.module:
            local |= {alias.asname or alias.name: f"{node.module}.{alias.name}" for alias in node.names}
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
            tops = {alias.name.partition(".")[0] for alias in node.names if not alias.asname}
            local |= {top: top for top in tops}
            local |= {alias.asname: alias.name for alias in node.names if alias.asname}
        elif isinstance(node, ast.Dict):
            texts = (value.value for value in node.values if isinstance(value, ast.Constant))
            dotted = (text.replace(":", ".") for text in texts if isinstance(text, str))
            found |= {text for text in dotted if DOTTED.fullmatch(text)}
    for node in nodes:
        if isinstance(node, ast.Attribute):
            first, _, rest = ast.unparse(node).partition(".")
            if first in local:
                found.add(f"{local[first]}.{rest}")
    return found


def used_by_text(text: str) -> set[str]:
    """Dotted names on a page or in a notebook: written out, or imported by a shown program."""
    imported = {f"{room}.{name}" for room, names in IMPORT.findall(text) for name in re.findall(r"\w+", names)}
    return imported | set(DOTTED.findall(text))


@cache
def users() -> dict[str, tuple[Path, ...]]:
    """Dotted name, and each of its beginnings, to the files that use it."""
    found = dict[str, list[Path]]()
    for file, names in _names_of_files():
        for name in {beginning for whole in names for beginning in _beginnings(whole)}:
            found.setdefault(name, []).append(file)
    return {name: tuple(files) for name, files in found.items()}


def _names_of_files() -> Iterator[tuple[Path, set[str]]]:
    for file in (file for top in USING for file in (ROOT / top).rglob("*.py")):
        yield file.relative_to(ROOT), used_by_code(file.read_text("utf-8"))
    pages = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "examples").rglob("*.ipynb")]
    for page in pages:
        if page.name != "CHANGELOG.md":  # it also names what is no longer there
            yield page.relative_to(ROOT), used_by_text(page.read_text("utf-8"))


def _beginnings(name: str) -> Iterator[str]:
    parts = name.split(".")
    yield from (".".join(parts[:count]) for count in range(2, len(parts) + 1))


def outside(name: str, file: Path) -> bool:
    """Whether a file (below the root) is neither in the room that states a name, nor in the room that the name is."""
    room = room_of(file)
    return room != name.rpartition(".")[0] and not f"{room}.".startswith(f"{name}.")


def room_of(file: Path) -> str:
    """The innermost room that a file, or what a test tests, is in; empty of anything else."""
    inner = Path(*file.parts[1:]) if file.parts[0] == "tests" else file
    folders = (".".join(folder.parts) for folder in inner.parents)
    return next((folder for folder in folders if folder in ROOMS), "")


@pytest.mark.parametrize("room", ROOMS)
def test_somebody_outside_a_room_uses_each_name_that_it_states(room: str) -> None:
    stated = {f"{room}.{name}" for name in import_module(room).__all__}
    unused = {name for name in stated if not any(outside(name, file) for file in users().get(name, ()))}
    assert unused - REASONS.keys() == set(), "no longer state them, or give a reason"
    assert unused >= stated & REASONS.keys(), "their reasons are no longer needed"


def test_each_reason_is_of_a_name_that_is_stated() -> None:
    assert [
        name for name in REASONS if name.rpartition(".")[2] not in import_module(name.rpartition(".")[0]).__all__
    ] == []


@pytest.mark.parametrize(
    ("source", "used"),
    [
        ("from gateway.config import Device as D, OtherBus", {"gateway.config.Device", "gateway.config.OtherBus"}),
        ("def f():\n    from drivers import modbus as m\n    m.ModbusBus()", {"drivers.modbus.ModbusBus"}),
        ("import talc\ntalc.Learner", {"talc.Learner"}),
        ("import talc.frame as f\nf.Frame.of", {"talc.frame.Frame.of"}),
        ("import gateway.clock\ngateway.clock.Ages", {"gateway.clock.Ages"}),
        ("{'db': 'gateway.cli.recorded.db'}", {"gateway.cli.recorded.db"}),
        ("{'keep': 'gateway.cli.recorded.db:keep'}", {"gateway.cli.recorded.db.keep"}),
    ],
)
def test_a_use_in_code_is_found(source: str, used: set[str]) -> None:
    assert used <= used_by_code(source)


@pytest.mark.parametrize("source", ["'gateway.config.Device'", "Device = 1\nconfig.Device", "# gateway.config.Device"])
def test_what_code_only_mentions_is_no_use(source: str) -> None:
    assert used_by_code(source) == set()


def test_a_use_on_a_page_is_found() -> None:
    page = "Derive from `gateway.config.OtherBus`.\n\n    from gateway.client import Machine, MachineError\n"
    assert used_by_text(page) == {
        "gateway.client",
        "gateway.client.Machine",
        "gateway.client.MachineError",
        "gateway.config.OtherBus",
    }


@pytest.mark.parametrize(
    ("name", "file", "is_outside"),
    [
        ("gateway.config.Device", "gateway/config/model.py", False),
        ("gateway.config.Device", "tests/gateway/config/test_config.py", False),
        ("gateway.config.Device", "gateway/config.py", True),
        ("gateway.config.Device", "gateway/scan/tcp.py", True),
        ("gateway.config.Device", "tests/gateway/scan/test_scan.py", True),
        ("gateway.config.Device", "tests/benches/rigs.py", True),
        ("drivers.error_words", "drivers/build.py", False),
        ("drivers.error_words", "drivers/can/bus.py", True),
        ("drivers.can", "drivers/can/bus.py", False),
        ("drivers.can", "tests/drivers/can/test_can_bus.py", False),
        ("drivers.can", "drivers/canopen/bus.py", True),
    ],
)
def test_a_room_and_its_own_tests_are_not_outside_it(name: str, file: str, is_outside: bool) -> None:
    assert outside(name, Path(file)) is is_outside
