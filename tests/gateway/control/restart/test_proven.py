"""What counts as shown: a dry run of this geometry, or a measurement with it; nothing else."""

from pathlib import Path

import numpy as np
import pytest

from gateway.config.file import parse
from gateway.config.model import GatewayConfig
from gateway.control.restart.earlier import earlier_run
from gateway.control.restart.proven import dry_run_wanted
from gateway.model.events import EventReported, MeasurementEnded
from gateway.model.probing import End, Outcome
from gateway.model.text import plain
from gateway.model.wording import event_of
from gateway.nc.probing.geometry import geometry_of, recorded
from gateway.storage.store import Store
from talc.frame import EventKind, Measurement, Why
from tests.benches.service_file import MACHINE, adam6015
from tests.benches.stepped_clock import SteppedClock

TEXT = f"""{MACHINE}
[nc]
kind = "sinumerik"
url = "opc.tcp://127.0.0.1:4840"
security = "none"
[storage]
path = "gateway.sqlite"
[probing]
armed = true
sphere_radius_mm = 120.0
""" + adam6015("bed = 0, column = 1")


def at(folder: Path, old: str = "", new: str = "") -> GatewayConfig:
    return parse(TEXT.replace(old, new), folder / "gateway.toml")


def proven(config: GatewayConfig) -> bool:
    """As the service, `check` and `status` find it."""
    wanted = dry_run_wanted(config)
    clock = SteppedClock()
    with Store(config.storage.path, "look", clock) as store:
        found = earlier_run(store, config).proven
    assert bool(wanted) is not found
    return found


def ran(config: GatewayConfig, boot: str, end: End | None, clock: SteppedClock) -> None:
    """A run of this configuration, in which one cycle ended so."""
    clock.spend(60.0)
    with Store(config.storage.path, boot, clock) as store:
        store.begin(config.canonical(), config.fingerprint(), "")
        clock.spend(60.0)
        if end is not None:
            found = Measurement(np.zeros(9), np.ones(9)) if end is End.MEASURED else None
            now = clock.utc()
            store.record(
                MeasurementEnded(
                    Outcome(5, Why.INTERVAL, now, now, np.zeros((6, 3)), (0.0, 0.0, 0.0), found, 0.1, plain(""), end)
                )
            )


@pytest.mark.parametrize("end", [None, *End])
def test_a_cycle_that_has_measured_counts_and_no_other_one(end: End | None, tmp_path: Path) -> None:
    config, clock = at(tmp_path), SteppedClock()
    ran(config, "first", end, clock)
    assert proven(config) is (end is End.MEASURED)


def test_it_counts_for_its_own_geometry_alone(tmp_path: Path) -> None:
    clock = SteppedClock()
    ran(at(tmp_path), "first", End.MEASURED, clock)
    moved = at(tmp_path, "= 120.0", "= 130.0")
    ran(moved, "second", End.REJECTED, clock)
    assert not proven(moved)
    assert not proven(at(tmp_path, "4840", "4841"))
    assert not proven(at(tmp_path, 'security = "none"', 'security = "none"\nchannel = 2'))
    assert not proven(at(tmp_path, 'security = "none"', 'security = "none"\norigin_mm = [0.0, 0.0, 1.0]'))
    assert proven(at(tmp_path)), "another limit or mode changes nothing"
    assert proven(at(tmp_path, "armed = true", "armed = true\nmax_repeat_um = 5.0"))


def test_a_dry_run_counts_before_the_first_run(tmp_path: Path) -> None:
    config, clock = at(tmp_path), SteppedClock()
    geometry = geometry_of(config)
    assert geometry is not None
    assert not proven(config)
    with Store(config.storage.path, "dry", clock) as store:
        store.record(EventReported(event_of(EventKind.OPERATOR, recorded(geometry, "6 poses")), None))
    assert proven(config)
    assert not proven(at(tmp_path, "= 120.0", "= 119.0"))


def test_the_paths_of_its_dry_runs_are_remembered_and_those_of_another_geometry_are_not(tmp_path: Path) -> None:
    config, clock = at(tmp_path), SteppedClock()
    for radius, path in ((120.0, "one"), (120.0, ""), (120.0, "two"), (119.0, "three")):
        geometry = geometry_of(at(tmp_path, "= 120.0", f"= {radius}"))
        assert geometry is not None
        with Store(config.storage.path, "dry", clock) as store:
            store.record(EventReported(event_of(EventKind.OPERATOR, recorded(geometry, "6 poses", path)), None))
    with Store(config.storage.path, "look", clock) as store:
        assert earlier_run(store, config).paths == {"one", "two"}


def test_a_control_without_dry_runs_needs_the_word_of_the_configuration(tmp_path: Path) -> None:
    config = at(tmp_path, "armed = true", 'armed = true\ndry_run = "not offered"')
    assert dry_run_wanted(config) == ""
    assert dry_run_wanted(at(tmp_path, "armed = true", "armed = false")) == ""


@pytest.mark.parametrize(
    ("new", "counts"),
    [
        ("channel = 1", True),
        ("origin_mm = [0.0, 0.0, 0.03]", False),
    ],
)
def test_a_reference_of_another_origin_is_none_and_a_new_one_is_measured(
    new: str, counts: bool, tmp_path: Path
) -> None:
    clock = SteppedClock()
    ran(at(tmp_path), "first", End.MEASURED, clock)
    moved = at(tmp_path, 'security = "none"', f'security = "none"\n{new}')
    ran(moved, "second", None, clock)
    with Store(moved.storage.path, "look", clock) as store:
        found = earlier_run(store, moved)
    assert (found.reference_mm is not None, found.renewing) == (counts, not counts)
    ran(moved, "third", End.MEASURED, clock)
    with Store(moved.storage.path, "look again", clock) as store:
        assert earlier_run(store, moved).renewing is not counts, "it was not the reference that was asked for"
