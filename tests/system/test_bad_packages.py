"""The bad packages replace lines that the program has: a test of minutes would only notice at its end."""

from pathlib import Path

import pytest

from tests.benches.bad_packages import BAD_PACKAGES, BadPackage

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("bad", BAD_PACKAGES, ids=lambda bad: bad.name)
def test_what_a_bad_package_replaces_is_in_the_program_once(bad: BadPackage) -> None:
    text = (ROOT / bad.module).with_suffix(".py").read_text("utf-8")
    assert text.count(bad.before) == 1
