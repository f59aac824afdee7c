"""Code that several test files share is in tests/benches; no test file is imported by another."""

import ast
from pathlib import Path

TESTS = Path(__file__).parent
STILL_IMPORT = {
    "drivers/test_patience.py",
    "gateway/acquisition/test_stale.py",
    "gateway/control/test_loop.py",
    "gateway/control/test_sensor_watch.py",
    "gateway/probing/test_rejected_measurements.py",
    "gateway/recordings/test_record_profiles.py",
    "gateway/telemetry/test_key_table.py",
    "simulators/test_emulated_faults.py",
    "system/test_endurance.py",
}
"""To be emptied: what they share has not moved to the benches yet."""


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


def test_no_further_file_imports_another_ones_tests() -> None:
    importing = {str(file.relative_to(TESTS)) for file in TESTS.rglob("*.py") if imports_a_test(file)}
    assert importing == STILL_IMPORT
