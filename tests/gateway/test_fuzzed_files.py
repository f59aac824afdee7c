"""Whatever stands in a file that a gateway is given: it is read, or refused with a text."""

import random
from pathlib import Path

import pytest

from tests.benches.fuzzed_files import FILES

MANY = {"recordings": 150, "toml": 100, "snapshot": 100}
"""Examples of a kind, if not 300."""


@pytest.mark.slow
@pytest.mark.parametrize("kind", FILES)
def test_any_file_is_read_or_refused_with_a_text(kind: str, tmp_path: Path) -> None:
    for seed in range(MANY.get(kind, 300)):
        FILES[kind](random.Random(seed), tmp_path)
