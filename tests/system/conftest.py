"""Fixtures of the tests of the page in a browser."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.benches.page_rig import MILL_SETTINGS, PageRig, chromium, page_rig, played_mill


@pytest.fixture(scope="module", autouse=True)
def browser_of_the_file(request: pytest.FixtureRequest) -> Iterator[None]:
    """The tests of a file with pages use one browser, which takes a second to start."""
    if any(hasattr(request.module, name) for name in ("PageRig", "page_rig", "chromium")):
        with chromium():
            yield
    else:
        yield


@pytest.fixture
def settings(tmp_path: Path) -> Path:
    """The settings of the page of the machine `mill`."""
    file = tmp_path / "web.toml"
    file.write_text(MILL_SETTINGS, encoding="utf-8")
    return file


@pytest.fixture(scope="module")
def looked_at(tmp_path_factory: pytest.TempPathFactory) -> Iterator[PageRig]:
    """A page beside the gateway `mill`, which has published its day, for the tests of a file that say nothing to it."""
    file = tmp_path_factory.mktemp("page") / "web.toml"
    file.write_text(MILL_SETTINGS, encoding="utf-8")
    with page_rig() as rig:
        played_mill(rig, file)
        yield rig
