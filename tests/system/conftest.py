"""Fixtures of the tests of the page in a browser."""

from pathlib import Path

import pytest

from tests.benches.page_rig import MILL_SETTINGS


@pytest.fixture
def settings(tmp_path: Path) -> Path:
    """The settings of the page of the machine `mill`."""
    file = tmp_path / "web.toml"
    file.write_text(MILL_SETTINGS, encoding="utf-8")
    return file
