"""The science imports arithmetic, and little else: a list of what it may, as no list of what it may not is complete."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

TALC = Path(__file__).parents[2] / "talc"
EVERYWHERE = frozenset(
    {
        *("abc", "bisect", "collections", "copy", "dataclasses", "enum", "functools", "hashlib", "inspect"),
        *("itertools", "json", "math", "numbers", "operator", "re", "typing", "warnings"),
        *("numpy", "osqp", "scipy", "talc"),
    }
)
ONLY_IN = {
    "importlib": {"__init__.py"},  # its names are imported when they are first used
    "pandas": {"estimators/rehearsal.py"},  # returns a DataFrame
    "sklearn": {"estimators/conventions.py"},  # only when scikit-learn itself asks for an estimator's tags
}


def imported(source: str) -> Iterator[str]:
    """Top-level name of every module that is imported, also inside a function or for the type checker."""
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.Import(names):
                yield from (alias.name.partition(".")[0] for alias in names)
            case ast.ImportFrom(module, _, 0) if module:
                yield module.partition(".")[0]
            case ast.ImportFrom():
                yield "talc"
            case ast.Call(ast.Name("__import__")):
                yield "__import__"


def strangers(source: str, file: str) -> set[str]:
    """What a module of the science imports and may not."""
    return {name for name in imported(source) if name not in EVERYWHERE and file not in ONLY_IN.get(name, ())}


def test_the_science_imports_nothing_else() -> None:
    found = {
        file: strangers((TALC / file).read_text("utf-8"), file)
        for file in (path.relative_to(TALC).as_posix() for path in sorted(TALC.rglob("*.py")))
    }
    assert len(found) > 40
    assert {file: names for file, names in found.items() if names} == {}


def test_nothing_is_allowed_that_is_not_needed() -> None:
    needed = {name for path in TALC.rglob("*.py") for name in imported(path.read_text("utf-8"))}
    assert EVERYWHERE | ONLY_IN.keys() == needed


@pytest.mark.parametrize(
    "name",
    [
        *("statsmodels", "cryptography", "pyarrow", "starlette", "duckdb", "pandas"),
        *("ctypes", "mmap", "shelve", "fileinput", "zoneinfo", "pickle", "fcntl", "smtplib", "os", "time"),
    ],
)
@pytest.mark.parametrize("form", ["import {}", "from {}.a import b", "def f():\n    import {}.a as c"])
def test_an_import_of_anything_else_is_found(name: str, form: str) -> None:
    assert strangers(form.format(name), "arx.py") == {name}
