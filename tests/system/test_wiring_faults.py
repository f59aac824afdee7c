"""docs/wiring.md shows what the commands really report for each mistake."""

from pathlib import Path

import pytest

from tests.benches.wiring_faults import DOCUMENT, FAULTS, blocks, comparable, told_of

pytestmark = pytest.mark.simulated_time

SHOWN = blocks(DOCUMENT.read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", FAULTS)
def test_document_shows_what_is_said(name: str, tmp_path: Path) -> None:
    said = told_of(name, tmp_path)
    assert comparable(said) == comparable(SHOWN[name])


def test_every_case_is_in_the_document() -> None:
    assert set(SHOWN) == set(FAULTS)
