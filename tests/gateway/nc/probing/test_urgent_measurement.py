"""A measurement of what is far too uncertain does not wait; and a schedule has the limits of its configuration."""

import math
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from drivers.nc import NcSnapshot, OperatingMode, ProgramState
from gateway.config.sections import Probing
from gateway.model.probing import End, Outlook
from gateway.model.standing import Standing
from gateway.model.text import plain
from gateway.nc.probing.schedule import excess, schedule_of
from talc.frame import Decision, FloatArray, Phase, Why

POSITIONS = {"X": 0.0, "Y": 0.0, "Z": 0.0, "A": 0.0, "C": 0.0}
IDLE = NcSnapshot(
    datetime(2026, 3, 2, tzinfo=UTC), 0.0, POSITIONS, {"spindle_speed": 0.0, "speed_X": 0.0},
    OperatingMode.AUTO, ProgramState.ABORTED, tool=3,
)  # fmt: skip
CUTTING = replace(IDLE, program=ProgramState.RUNNING, states={"spindle_speed": 8000.0, "speed_X": 900.0})
OTHER_TOOL = replace(CUTTING, tool=4)


def test_a_measurement_waits_no_longer_once_an_uncertainty_is_far_above_its_limit() -> None:
    plan = schedule_of(Probing())
    plan.want(Why.UNCERTAINTY, 0.0, 2.0)
    assert plan.look(CUTTING, 0.0).standing is Standing.WAITING
    plan.want(Why.UNCERTAINTY, 300.0, 2.01)
    assert plan.look(CUTTING, 300.0) == Outlook(Standing.DUE, Why.UNCERTAINTY)
    plan.want(Why.UNCERTAINTY, 600.0, 1.9)
    assert plan.look(CUTTING, 600.0).standing is Standing.WAITING


def test_a_schedule_has_the_limits_of_its_configuration() -> None:
    plan = schedule_of(Probing(prefer_idle_s=100.0, insist_after_s=500.0, urgent_excess=3.0, retries=0, pause_s=50.0))
    plan.want(Why.UNCERTAINTY, 0.0, 2.9)
    assert plan.look(CUTTING, 0.0).standing is Standing.WAITING
    assert plan.look(OTHER_TOOL, 99.0).standing is Standing.WAITING
    assert plan.look(replace(CUTTING, tool=5), 101.0).standing is Standing.DUE
    assert plan.look(replace(CUTTING, tool=5), 499.0).standing is Standing.WAITING
    assert plan.look(replace(CUTTING, tool=5), 500.0).standing is Standing.DUE
    plan.want(None, 501.0)
    plan.want(Why.UNCERTAINTY, 502.0, 3.1)
    assert plan.look(replace(CUTTING, tool=5), 502.0).standing is Standing.DUE
    plan.asked()
    assert plan.ended(End.REJECTED, plain("a touch found no sphere"), 600.0).standing is Standing.BLOCKED
    assert plan.look(IDLE, 649.0).standing is Standing.BLOCKED
    assert plan.look(IDLE, 651.0).standing is Standing.DUE


def test_excess_is_of_the_error_that_is_least_known() -> None:
    sigma = np.array([1.0, 2.0, math.nan, 0.5, 1.0, 1.0, 3.0, 1.0, 1.0])
    limits = np.array([5.0, 5.0, 5.0, math.nan, 5.0, 5.0, 15.0, 15.0, 15.0])
    assert excess(decision(sigma, limits)) == pytest.approx(1.96 * 2.0 / 5.0)
    assert excess(decision(np.full(9, math.nan), limits)) == 0.0


def decision(sigma: FloatArray, limits: FloatArray) -> Decision:
    return Decision(
        k=0,
        phase=Phase.COMPENSATION,
        predicted=np.zeros(9),
        corrected=np.zeros(9),
        sigma=sigma,
        limits=limits,
        measure=Why.UNCERTAINTY,
        training=None,
        events=(),
    )
