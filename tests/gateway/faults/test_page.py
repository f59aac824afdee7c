"""The table for users matches the faults that the tests play."""

from tests.benches.faults.page import PAGE, page


def test_the_table_is_written_from_the_faults_that_are_played() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), "python -m tests.benches.faults.page"
