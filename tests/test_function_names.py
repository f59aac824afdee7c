"""The name of a public function or constant means one thing in all rooms."""

import ast
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

ROOT = Path(__file__).parents[1]
SERVICE = ("talc", "drivers", "gateway", "simulators")
FUNCTIONS_ALLOWED = {
    "learns": "a part of each study",
    "main": "begins each program",
    "report": "a part of each study",
    "rows": "what each subject of the benchmarks prints",
    "run": "a part of each study",
    "runs": "a part of each study",
    "show": "what a command of the command line does, one in each of its modules",
}
CONSTANTS_ALLOWED = {
    "FloatArray": "the machine is physics and does not know the science; both mean an array of numpy",
    "INPUTS": "how many inputs a device has, one in each emulated device",
    "M": "a type variable",
    "T": "a type variable",
    "log": "each module's own logger",
}


def functions(module: ast.Module) -> Iterator[str]:
    """Public ones; a command of the command line bears the name that users type."""
    for node in module.body:
        match node:
            case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name) if not name.startswith("_"):
                if not any(".command(" in ast.unparse(decorator) for decorator in node.decorator_list):
                    yield name


def constants(module: ast.Module) -> Iterator[str]:
    """Public names that a module assigns, alone or in a tuple."""
    for node in module.body:
        match node:
            case ast.Assign(targets=targets):
                stored = [name for target in targets for name in ast.walk(target)]
            case ast.AnnAssign(target=target):
                stored = [target]
            case _:
                continue
        yield from (n.id for n in stored if isinstance(n, ast.Name) and not n.id.startswith("_"))


def twice(rooms: Sequence[str], names: Callable[[ast.Module], Iterator[str]]) -> Mapping[str, list[str]]:
    """Names that more than one module defines, and where."""
    places = defaultdict(list)
    for room in rooms:
        for file in (ROOT / room).rglob("*.py"):
            for name in names(ast.parse(file.read_text("utf-8"))):
                places[name].append(str(file.relative_to(ROOT)))
    assert len(places) > 400, "the rooms were found"
    return {name: files for name, files in places.items() if len(files) > 1}


def test_no_two_functions_have_one_name() -> None:
    found = twice((*SERVICE, "studies", "benchmarks"), functions)
    assert {name: files for name, files in found.items() if name not in FUNCTIONS_ALLOWED} == {}
    assert FUNCTIONS_ALLOWED.keys() <= found.keys(), "an exception that is no longer needed"


def test_no_two_constants_of_the_service_and_the_simulators_have_one_name() -> None:
    """Those of studies and benchmarks are the settings of each."""
    found = twice(SERVICE, constants)
    assert {name: files for name, files in found.items() if name not in CONSTANTS_ALLOWED} == {}
    assert CONSTANTS_ALLOWED.keys() <= found.keys(), "an exception that is no longer needed"
