"""Code that several test files share is in tests/benches; no test file is imported by another."""

import ast
from pathlib import Path

TESTS = Path(__file__).parent


def imported(file: Path) -> set[str]:
    """Last names of all modules that the file imports, in any form of the statement."""
    names = set()
    for node in ast.walk(ast.parse(file.read_text("utf-8"))):
        if isinstance(node, ast.ImportFrom):
            names |= {node.module or "", *(alias.name for alias in node.names)}
        elif isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
    return {name.rpartition(".")[2] for name in names}


def imports_a_test(file: Path) -> bool:
    return not imported(file).isdisjoint(path.stem for path in TESTS.rglob("test_*.py"))


def test_no_file_imports_another_ones_tests() -> None:
    assert [str(file.relative_to(TESTS)) for file in TESTS.rglob("*.py") if imports_a_test(file)] == []
