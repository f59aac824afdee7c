"""The demo in simulated time, and the figures that the README takes from it."""

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks import demo
from gateway.demo.demo_machine import Demo, talc_section
from gateway.reporting.data import ReportData, Truth
from gateway.reporting.figures import summary
from simulators.bench.machine import DEMO_TERMS
from talc.settings import LearnerSettings, TalcSettings

HOURS = 6.0


@pytest.fixture(scope="module")
def run() -> ReportData:
    return demo.DemoLoop(1, HOURS).run()


@pytest.mark.slow
def test_it_measures_learns_and_shifts_the_tool_as_the_demo_does(run: ReportData) -> None:
    assert run.truth is not None
    assert len(run.k) == HOURS * 12
    found = summary(run)
    assert found.begin_hours == 0.25, "five cycles of the reference"
    assert HOURS / 4 <= found.measurements <= HOURS * 3
    z = next(row for row in found.tool if row.name == "tool Z")
    assert z.compensated_e_rms < 0.5 * z.e_rms
    # What was probed is what the machine did, apart from the noise of probing and of the reference.
    seen = np.flatnonzero(np.isfinite(run.measured).all(axis=1))
    at = np.searchsorted(run.truth.time_s, run.time_s[seen])
    off = run.measured[seen] - run.truth.errors[at]
    assert (np.abs(np.median(off[:, :6], axis=0)) < 3.0).all()


def test_its_learner_has_the_settings_of_the_demo_s_configuration() -> None:
    asked = Demo(1.0, "learner", None, None, 1.0, 1, Path(), 0, (), plain=True)
    section = tomllib.loads(f"[talc]\n{talc_section(asked)}")["talc"]
    assert section["method"] == demo.LEARNER.method
    assert TalcSettings(learner=LearnerSettings(**section["learner"])) == demo.LEARNER, "nothing else is set"


def test_the_control_follows_its_axes_so_that_each_direction_gains(run: ReportData) -> None:
    left = {row.name: row.compensated_e_rms / row.e_rms for row in summary(run).tool}
    assert max(left.values()) < 0.8, left


def test_what_the_machine_does_after_the_gateway_has_stopped_is_not_judged(run: ReportData) -> None:
    truth = run.truth
    assert truth is not None
    after = run.time_s[-1] + 60.0 * np.arange(1, 61)
    hot = np.full((60, 3), 100.0)
    longer = Truth(
        np.concatenate([truth.time_s, after]),
        np.concatenate([truth.errors, np.full((60, 9), 100.0)]),
        np.concatenate([truth.uncompensated_um, hot]),
        np.concatenate([truth.compensated_um, hot]),
        np.concatenate([truth.probing, np.zeros(60, dtype=np.bool_)]),
    )
    assert repr(summary(replace(run, truth=longer))) == repr(summary(run)), "numbers that are not known compare unequal"


def test_no_axis_is_shifted_beyond_the_bound() -> None:
    terms = replace(DEMO_TERMS, bound_um=(150.0, 150.0, 5.0))
    truth = demo.DemoLoop(1, 3.0, terms=terms).run().truth
    assert truth is not None
    shift = np.abs(truth.compensated_um - truth.uncompensated_um).max(axis=0)
    assert shift[2] == pytest.approx(5.0, abs=0.01)
    assert shift[1] > 5.0
