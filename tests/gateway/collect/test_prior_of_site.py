"""A prior from the folder of a collector is the one from the databases themselves, byte by byte."""

import json
from collections.abc import Iterator
from dataclasses import replace
from itertools import count
from pathlib import Path

import numpy as np
import pytest
from pyarrow import parquet

from gateway.collect import CollectError, Collector, SiteFolder, machines_in
from gateway.config import load
from gateway.events import DecisionMade, FrameMade
from gateway.storage import Store
from talc.frame import Frame, Measurement
from tests.benches import telemetry_examples as example
from tests.benches.machines_of_a_kind import CHANNELS, day, frames, talc_gateway, written
from tests.benches.stepped_clock import SteppedClock
from tests.benches.stored_site import StoredSite

STEPS = 150
FIRST_K = 5_900_000
OTHER_ORDER = (*CHANNELS[6:], *CHANNELS[:6])


def spoilt(seed: int) -> Iterator[Frame]:
    """Steps as a machine has them: gaps, inputs without a good value, errors that a cycle does not determine, and a
    start without a clock."""
    for n, frame in enumerate(frames(day(seed))[:STEPS]):
        if 50 <= n < 54:
            continue
        here = replace(frame, k=FIRST_K + n, pause_unknown=n == 90)
        if n % 7 == 3:
            valid = np.arange(len(CHANNELS)) != seed % 5
            here = replace(here, valid=valid, inputs=np.where(valid, here.inputs, 1e300))
        if n == 33 and here.measurement is not None:
            errors = np.where(np.arange(9) == 4, np.nan, here.measurement.errors)
            here = replace(here, measurement=Measurement(errors, here.measurement.sigma * 3.0))
        yield here


def work(folder: Path, seed: int, kind: str | None = None) -> None:
    """A machine that ran, and after a restart with its channels in another order."""
    found, places = list(spoilt(seed)), [CHANNELS.index(name) for name in OTHER_ORDER]
    rest = [replace(f, inputs=f.inputs[places], valid=f.valid[places]) for f in found[70:]]
    for channels, some in ((CHANNELS, found[:70]), (OTHER_ORDER, rest)):
        config = load(written(folder, f"mill{seed}", channels=channels, kind=kind))
        with Store(config.storage.path, f"run{some[0].k}", SteppedClock(), commit_s=60.0) as store:
            store.begin(config.canonical(), config.fingerprint(), "")
            for frame in some:
                store.record(FrameMade(frame))
                store.record(DecisionMade(replace(example.DECISION, k=frame.k)))


def collected(gateways: Path, site: Path) -> Path:
    with SiteFolder(site) as folder:
        collecting = Collector(StoredSite(gateways), folder, limit=100)
        for turn in count():
            if collecting.turn(0.0) > 0.0 and turn:
                break
    assert not [asked.problem for asked in collecting.machines.values() if asked.problem]
    return site


@pytest.fixture(scope="module")
def gateways(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("gateways")
    for seed, kind in ((10, "dmu"), (11, "dmu"), (12, None)):
        work(folder, seed, kind)
    return folder


@pytest.fixture(scope="module")
def site(gateways: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return collected(gateways, tmp_path_factory.mktemp("site"))


def test_the_prior_of_a_kind_is_the_same_from_the_site_as_from_the_databases(
    gateways: Path, site: Path, tmp_path: Path
) -> None:
    of_site, of_databases = tmp_path / "site.json", tmp_path / "databases.json"
    answer = talc_gateway("prior", "make", site, "--kind", "dmu", "-o", of_site)
    assert answer.exit_code == 0, answer.output
    databases = (gateways / "mill10.sqlite", gateways / "mill11.sqlite")
    assert talc_gateway("prior", "make", *databases, "-o", of_databases).exit_code == 0
    assert of_site.read_bytes() == of_databases.read_bytes()
    assert "mill12" not in answer.output
    assert next(iter(json.loads(of_site.read_bytes())["errors"].values()))["machines"] == 2


def test_machines_of_several_kinds_are_not_mixed_unasked(site: Path, tmp_path: Path) -> None:
    output = tmp_path / "kind.json"
    mixed = talc_gateway("prior", "make", site, "-o", output)
    unknown = talc_gateway("prior", "make", site, "--kind", "lathe", "-o", output)
    assert (mixed.exit_code, unknown.exit_code, output.exists()) == (2, 2, False)
    assert "different [machine] kind (dmu: mill10, mill11; no kind: mill12); choose one with --kind" in mixed.output
    assert "--kind lathe: no machine has this [machine] kind (dmu: mill10, mill11; no kind: mill12)" in unknown.output


def test_rows_that_are_there_twice_and_a_grid_of_another_step_change_nothing(
    gateways: Path, site: Path, tmp_path: Path
) -> None:
    again = collected(gateways, tmp_path / "again")
    part = min((again / "steps" / "machine=mill10").glob("day=*/part-*.parquet"))
    table = parquet.read_table(part, partitioning=None)
    parquet.write_table(table, part.with_name("part-00098.parquet"))
    k = table.column_names.index("k")
    parquet.write_table(table.set_column(k, "k", [np.asarray(table["k"]) * 5]), part.with_name("part-00099.parquet"))
    (machine, *_), (twice, *_) = machines_in(site), machines_in(again)
    assert [f.k for f in twice.frames()] == [f.k for f in machine.frames()] == [f.k for f in spoilt(10)]
    assert twice.inputs == OTHER_ORDER


def test_a_folder_that_cannot_be_read_is_refused(site: Path, tmp_path: Path) -> None:
    with pytest.raises(CollectError, match="holds no run of a machine; give a folder of `talc-gateway collect`"):
        machines_in(tmp_path)
    (tmp_path / "runs" / "machine=mill").mkdir(parents=True)
    with pytest.raises(CollectError, match="its latest run cannot be read"):
        machines_in(tmp_path)
    answer = talc_gateway("prior", "make", tmp_path, "-o", tmp_path / "a.json")
    assert answer.exit_code == 3
