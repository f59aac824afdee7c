"""The controller's record: gaps are filled, late sensors are not lost, impossible numbers are omitted."""

import numpy as np
import pytest
from numpy.typing import NDArray

from talc.control import Controller
from talc.frame import LARGEST_ERROR, LARGEST_INPUT, EventKind, Frame, Measurement
from talc.kinds import EventCode
from talc.models import ModelSet
from talc.papers.phased import PhasedState
from talc.papers.training import train
from talc.record import Record
from talc.settings import ControlSettings, TalcSettings
from tests.benches.thermal_series import ThermalSeries, series

Array = NDArray[np.float64]

CALIBRATION = 144


def filled(rows: list[list[float]]) -> Record:
    record = Record(len(rows[0]), None)
    for k, row in enumerate(rows):
        record.append(Frame(k, np.array(row), np.ones(len(row), dtype=np.bool_)))
    return record


def learnt(s: ThermalSeries, inputs: Array) -> ModelSet:
    """The first models of a controller that sees these inputs."""
    controller = Controller(
        s.names, TalcSettings(method="models", control=ControlSettings(calibration_steps=CALIBRATION))
    )
    for k in range(CALIBRATION):
        decision = controller.step(Frame(k, inputs[k], np.isfinite(inputs[k]), Measurement(s.measured[k], np.ones(9))))
    assert decision.training is not None
    return train(decision.training)


def test_a_missing_value_is_the_last_good_one_and_before_the_first_that_one() -> None:
    nan = np.nan
    record = filled([[nan, 1.0, nan], [nan, nan, nan], [5.0, 3.0, nan], [nan, 4.0, nan], [7.0, nan, nan]])
    assert record.inputs[:, 0].tolist() == [5.0, 5.0, 5.0, 5.0, 7.0]
    assert record.inputs[:, 1].tolist() == [1.0, 1.0, 3.0, 4.0, 4.0]
    assert np.isnan(record.inputs[:, 2]).all()
    assert record.valid[:, 0].tolist() == [False, False, True, False, True]


@pytest.mark.parametrize("late", [1, 12])
def test_a_sensor_that_is_late_at_the_start_is_not_lost(late: int) -> None:
    s = series(CALIBRATION, 4)
    whole = learnt(s, s.inputs)
    used = next(m for m in whole.models if m is not None).inputs[0]
    inputs = s.inputs.copy()
    inputs[:late, s.names.index(used)] = np.nan
    models = learnt(s, inputs)
    assert not models.notes
    assert used in {name for m in models.models if m is not None for name in m.inputs}


def test_a_sensor_that_is_late_by_more_than_a_fifth_is_not_offered_and_the_share_is_reported() -> None:
    s = series(CALIBRATION, 4)
    inputs = s.inputs.copy()
    inputs[:29, 0] = np.nan
    (note,) = (note for note in learnt(s, inputs).notes if note.code is EventCode.INPUT_SELDOM_GOOD)
    assert note.values == {"input": "t0", "share": pytest.approx(115 / 144), "least": 0.8}


def test_impossible_numbers_are_missing_values() -> None:
    for wild in (1e13, -1e200, 1e308, np.inf):
        assert filled([[20.0], [wild], [21.0]]).inputs[:, 0].tolist() == [20.0, 20.0, 21.0]
    assert filled([[20.0], [LARGEST_INPUT]]).inputs[1, 0] == LARGEST_INPUT


@pytest.mark.parametrize("wild", [1e7, -1e200, 1e308, np.inf])
def test_an_impossible_measurement_is_reported_and_not_used(wild: float) -> None:
    controller = Controller(("t0",), TalcSettings(method="models"))
    errors = np.full(9, 2.0)
    errors[2] = wild
    decision = controller.step(Frame(0, np.ones(1), np.ones(1, dtype=np.bool_), Measurement(errors, np.ones(9))))
    (event,) = [e for e in decision.events if e.kind is EventKind.MEASUREMENT_REJECTED]
    assert (event.error, event.limit) == ("EX0C", LARGEST_ERROR)
    assert (event.code, event.values["value"], event.values["unit"]) == (EventCode.IMPOSSIBLE, wild, "µm")
    strategy = controller.state().strategy
    assert isinstance(strategy, PhasedState)
    held = strategy.held
    assert np.isnan(held[2])
    assert np.isfinite(np.delete(held, 2)).all()
