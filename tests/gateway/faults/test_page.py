"""The page for users matches the faults that the tests play."""

from pathlib import Path

from tests.benches.faults.page import page


def test_the_page_is_written_from_the_table() -> None:
    written = Path(__file__).parents[3] / "docs" / "faults.md"
    assert written.read_text(encoding="utf-8") == page(), "python -m tests.benches.faults.page > docs/faults.md"
