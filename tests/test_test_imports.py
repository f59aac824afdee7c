"""Code that several test files share is in tests/benches; no test file is imported by another.

Tests use what a room offers. To put a defect where it does harm, or to drive a library, a few reach behind it.
"""

import ast
import re
from pathlib import Path

TESTS = Path(__file__).parent
REACH_BEHIND = {
    "benches/loop_clock.py": "asyncio does not tell otherwise whether its loop has work",
    "benches/planted_for_kills.py": "plants defects",
    "system/test_fuzz_finds.py": "plants defects",
}


def imported(file: Path) -> set[str]:
    """Last names of all modules that the file imports, in any form of the statement."""
    names = set()
    for node in ast.walk(ast.parse(file.read_text("utf-8"))):
        if isinstance(node, ast.ImportFrom):
            names |= {node.module or "", *(alias.name for alias in node.names)}
        elif isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
    return {name.rpartition(".")[2] for name in names}


def test_no_file_imports_another_ones_tests() -> None:
    tests = {path.stem for path in TESTS.rglob("test_*.py")}
    mention = re.compile(rf"\b(?:{'|'.join(tests)})\b")
    suspects = [file for file in TESTS.rglob("*.py") if mention.search(file.read_text("utf-8"))]
    assert len(suspects) > 10, "docstrings mention test files"
    assert [str(file.relative_to(TESTS)) for file in suspects if not imported(file).isdisjoint(tests)] == []


def test_only_those_that_plant_defects_reach_behind_what_a_room_offers() -> None:
    """Ruff reports the others (SLF001)."""
    excused = re.compile(r"noqa:.*\bSLF(?:001)?\b")
    found = {str(file.relative_to(TESTS)) for file in TESTS.rglob("*.py") if excused.search(file.read_text("utf-8"))}
    assert found - {Path(__file__).name} == REACH_BEHIND.keys()
