"""Three machines that have run, the folder of a collector that has all of it, an empty site, and a database server."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.benches.collected_machines import collected, work
from tests.benches.postgres import Postgres, postgres
from tests.benches.stored_site import StoredSite


@pytest.fixture(scope="module")
def server() -> Iterator[Postgres]:
    with postgres() as running:
        yield running


@pytest.fixture(scope="module")
def gateways(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("gateways")
    for seed, kind in ((10, "dmu"), (11, "dmu"), (12, None)):
        work(folder, seed, kind)
    return folder


@pytest.fixture
def stored_site(tmp_path: Path) -> StoredSite:
    (tmp_path / "gateways").mkdir()
    return StoredSite(tmp_path / "gateways")


@pytest.fixture(scope="module")
def site(gateways: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    collected(gateways, str(folder))
    return folder
