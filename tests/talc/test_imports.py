"""The science imports arithmetic, and little else: a list of what it may, as no list of what it may not is complete."""

import ast
from collections.abc import Iterator
from pathlib import Path

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


def test_the_science_imports_nothing_else() -> None:
    files = {path.relative_to(TALC).as_posix(): path.read_text("utf-8") for path in TALC.rglob("*.py")}
    found = {(file, name) for file, source in files.items() for name in imported(source)}
    assert len(files) > 40
    assert {(f, name) for f, name in found if name not in EVERYWHERE and f not in ONLY_IN.get(name, ())} == set()
