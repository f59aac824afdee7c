"""A prior from the folder of a collector is the one from the databases themselves, byte by byte."""

import json
from pathlib import Path

import numpy as np
import pytest
from pyarrow import parquet

from gateway.listeners.collect.folder import CollectError
from gateway.listeners.collect.machines import machines_in
from tests.benches.collected_machines import OTHER_ORDER, collected, spoilt
from tests.benches.machines_of_a_kind import talc_gateway


@pytest.mark.slow
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
    again = tmp_path / "again"
    collected(gateways, str(again))
    part = min((again / "steps" / "machine=mill10").glob("day=*/part-*.parquet"))
    table = parquet.read_table(part, partitioning=None)
    parquet.write_table(table, part.with_name("part-00098.parquet"))
    k = table.column_names.index("k")
    parquet.write_table(table.set_column(k, "k", [np.asarray(table["k"]) * 5]), part.with_name("part-00099.parquet"))
    (machine, *_), (twice, *_) = machines_in(site), machines_in(again)
    assert [f.k for f in twice.frames()] == [f.k for f in machine.frames()] == [f.k for f in spoilt(10)]
    assert twice.inputs == OTHER_ORDER


def test_a_folder_that_cannot_be_read_is_refused(site: Path, tmp_path: Path) -> None:
    with pytest.raises(CollectError, match="contains no run of any machine; give a folder of `talc-gateway collect`"):
        machines_in(tmp_path)
    (tmp_path / "runs" / "machine=mill").mkdir(parents=True)
    with pytest.raises(CollectError, match="its latest run cannot be read"):
        machines_in(tmp_path)
    answer = talc_gateway("prior", "make", tmp_path, "-o", tmp_path / "a.json")
    assert answer.exit_code == 3
