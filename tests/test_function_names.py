"""A public function's name means one thing in all rooms of the service and the simulators."""

import ast
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
ROOMS = ("talc", "drivers", "gateway", "simulators")
ALLOWED = {
    "main": "begins each program",
    "show": "what a command of the command line does, one in each of its modules",
}


def functions(file: Path) -> Iterator[str]:
    """Public ones of a module; a command of the command line bears the name that users type."""
    for node in ast.parse(file.read_text("utf-8")).body:
        match node:
            case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name) if not name.startswith("_"):
                if not any(".command(" in ast.unparse(decorator) for decorator in node.decorator_list):
                    yield name


def test_no_two_functions_have_one_name() -> None:
    places = defaultdict(list)
    for room in ROOMS:
        for file in (ROOT / room).rglob("*.py"):
            for name in functions(file):
                places[name].append(str(file.relative_to(ROOT)))
    assert len(places) > 600, "the rooms were found"
    twice = {name: files for name, files in places.items() if len(files) > 1}
    assert {name: files for name, files in twice.items() if name not in ALLOWED} == {}
    assert ALLOWED.keys() <= twice.keys(), "an exception that is no longer needed"
