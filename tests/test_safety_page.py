"""docs/safety.md promises that each line is shown by a test: every test it names must exist."""

import re
from pathlib import Path

TESTS = Path(__file__).parent
PAGE = (TESTS.parent / "docs" / "safety.md").read_text(encoding="utf-8")


def named() -> set[str]:
    """What stands in backticks in the last column of the page's tables, without parameters."""
    rows = [line for line in PAGE.splitlines() if line.startswith("|") and not set(line) <= set("|- ")]
    cells = (row.strip("|").rsplit("|", 1)[-1] for row in rows)
    found = {name for cell in cells for name in re.findall(r"`([^`]+)`", cell)}
    return {re.sub(r"(\[.*\]|\.\.\.)+$", "", name) for name in found} - {""}


def test_every_test_that_the_safety_page_names_exists() -> None:
    files = {path.name: path.read_text(encoding="utf-8") for path in TESTS.rglob("test_*.py")}
    tests = "\n".join(re.findall(r"def test_(\w+)", "\n".join(files.values())))
    names = named()
    assert len(names) > 25
    missing = {
        name
        for name in names
        if not (
            re.search(rf"^{re.escape(name)}", tests, re.MULTILINE)
            or f"{name}.py" in files
            or (TESTS.parent / name).exists()
            or (TESTS.parent / f"{name}.py").exists()
        )
    }
    assert missing == set()
