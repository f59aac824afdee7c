"""A power cut at any moment of writing loses what was not reported as stored, and nothing else."""

from pathlib import Path

import pytest

from tests.benches.power_cuts import DiskAct, cut_and_start, recorded

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def acts(tmp_path_factory: pytest.TempPathFactory) -> list[DiskAct]:
    return recorded(tmp_path_factory.mktemp("session"))


def wrong(acts: list[DiskAct], seeds: range, folder: Path) -> list[str]:
    found = []
    for seed in seeds:
        here = folder / str(seed)
        here.mkdir()
        found += [f"seed {seed}: {text}" for text in cut_and_start(acts, seed, here).wrong]
    return found


def test_no_power_cut_tears_the_store_or_loses_what_was_reported_as_stored(acts: list[DiskAct], tmp_path: Path) -> None:
    assert wrong(acts, range(20), tmp_path) == []


def test_a_disk_that_does_not_synchronise_is_found_out(acts: list[DiskAct], tmp_path: Path) -> None:
    """The judge can see it: on such a disk steps are lost, or the store is torn."""
    lying = [act for i, act in enumerate(acts) if act.what != "s" or i < len(acts) // 10]
    assert wrong(lying, range(6), tmp_path) != []
