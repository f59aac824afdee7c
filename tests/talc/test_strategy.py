"""Every strategy behind the controller: what it decides, what is kept of it, and that it goes on from there."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Literal

import numpy as np
import pytest

from talc.control import Controller, ControllerState
from talc.frame import Decision, FloatArray, Frame, Frames, Measurement, Phase, Why
from talc.hold import MeasureAndHold
from talc.settings import ControlSettings, TalcSettings, TrainingSettings
from talc.snapshot import from_plain, to_plain
from talc.strategy import Strategy
from talc.transfer import transferred
from tests.benches.control_models import INPUTS, models

CALIBRATION = 12
INTERVAL = 4
CONTROL = ControlSettings(calibration_steps=CALIBRATION, measurement_interval_steps=INTERVAL)
METHODS = ("learner", "models", "hold")


def own(method: str) -> Strategy | None:
    return MeasureAndHold(INTERVAL) if method == "hold" else None


def settings(method: str) -> TalcSettings:
    return TalcSettings(method="models" if method == "models" else "learner", control=CONTROL)


def heated(k: int) -> FloatArray:
    return np.array([20.0 + 5.0 * np.sin(k / 9), 30.0 + 0.1 * k])


def day(count: int) -> Iterator[Frame]:
    """Every fourth step measured, after a calibration in which all are; one gap, one input missing for a while."""
    for k in range(count):
        if k in (20, 21):
            continue
        valid = np.array([k not in range(25, 30), True])
        measured = k < CALIBRATION or k % INTERVAL == 0
        errors = 0.5 * heated(k)[0] + np.arange(9.0)
        yield Frame(k, heated(k), valid, Measurement(errors, np.ones(9)) if measured else None)


def run(controller: Controller, frames: Iterator[Frame]) -> list[Decision]:
    found = []
    for frame in frames:
        found.append(controller.step(frame))
        if controller.learning:
            controller.adopt(models(frame.k))
    return found


def same(one: list[Decision], other: list[Decision]) -> None:
    """Bit for bit."""
    for a, b in zip(one, other, strict=True):
        assert (a.k, a.phase, a.measure, a.events, a.substituted) == (b.k, b.phase, b.measure, b.events, b.substituted)
        for name in ("predicted", "corrected", "sigma", "limits", "trusted"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


@pytest.mark.parametrize("method", METHODS)
def test_a_snapshot_goes_on_as_if_nothing_had_happened(method: str) -> None:
    whole = run(Controller(INPUTS, settings(method), strategy=own(method)), day(60))
    first = Controller(INPUTS, settings(method), strategy=own(method))
    frames = list(day(60))
    run(first, iter(frames[:35]))
    again = Controller.restore(kept(first, frames), settings(method), strategy=own(method))
    same(run(again, iter(frames[35:])), whole[35:])


def kept(controller: Controller, frames: list[Frame]) -> ControllerState:
    """The controller's state, by a snapshot."""

    def stored(begin: int, end: int) -> Frames:
        some = [frame for frame in frames if begin <= frame.k <= end]
        none = np.full(9, np.nan)
        return Frames(
            np.array([f.k for f in some]),
            np.array([f.inputs for f in some]),
            np.array([f.valid for f in some]),
            np.array([none if f.measurement is None else f.measurement.errors for f in some]),
        )

    return from_plain(*to_plain(controller.state()), stored)


@pytest.mark.parametrize(
    ("selector", "estimator", "restart"),
    [("tck", "guarded", False), ("tck", "guarded", True), ("tck", "least_squares", False), ("pso", "refined", False)],
)
def test_an_output_that_was_not_measured_is_trained_on_as_it_was_estimated(
    selector: Literal["tck", "pso"], estimator: Literal["guarded", "least_squares", "refined"], restart: bool
) -> None:
    training = TrainingSettings(selector=selector, estimator=estimator, max_na=2, static_inputs=True)
    chosen = replace(settings("models"), training=training, control=replace(CONTROL, no_good_measurements=3))
    controller, frames = Controller(INPUTS, chosen), [frame for frame in day(80) if frame.k not in (46, 47)]
    estimated, last = np.full((80, 9), np.nan), None
    for frame in frames:
        if restart and frame.k == 40:
            controller = Controller.restore(kept(controller, frames), chosen)
        decision = controller.step(frame)
        estimated[frame.k] = decision.predicted
        if decision.training is not None:
            last = decision.training
            controller.adopt(models(frame.k))
    assert last is not None
    assert last.k > 48
    measured = np.isfinite(last.measured[:, 0])
    asked = [k for k in range(CALIBRATION, last.k) if not measured[k] and measured[k + 1 : k + 3].any()]
    assert len(asked) > 8
    assert last.estimated is not None
    np.testing.assert_array_equal(last.estimated[asked], estimated[asked])
    unasked = [k for k in range(24, 46) if not measured[k] and k not in asked]  # between two gaps
    assert len(unasked) > 4
    assert np.isnan(last.estimated[unasked[:-2]]).all(), "nothing is kept that no training needs"


@pytest.mark.parametrize("method", METHODS)
def test_a_state_of_another_method_is_refused(method: str) -> None:
    state = Controller(INPUTS, settings(method), strategy=own(method)).state()
    for other in set(METHODS) - {method}:
        with pytest.raises(ValueError, match="made with the other method"):
            Controller.restore(state, settings(other), strategy=own(other))
        with pytest.raises(ValueError, match=rf"method = '{method}'.*'{other}'"):
            transferred(state, Controller(INPUTS, settings(other), strategy=own(other)).state())


@pytest.mark.parametrize("method", ["learner", "hold"])
def test_what_trains_nothing_takes_no_models(method: str) -> None:
    controller = Controller(INPUTS, settings(method), strategy=own(method))
    assert not any(decision.training for decision in run(controller, day(30)))
    assert len(controller.state().inputs) <= 2, "its record does not grow"
    with pytest.raises(ValueError, match="takes no models"):
        controller.adopt(models(0))


@pytest.mark.parametrize("method", ["models", "hold"])
def test_what_has_no_forecast_says_so(method: str) -> None:
    controller = Controller(INPUTS, settings(method), strategy=own(method))
    run(controller, day(30))
    assert controller.forecast([12]) is None
    assert (controller.explain(), controller.weights(), controller.reasons()) == (None, None, None)
    assert controller.between(heated(30), np.ones(2, dtype=np.bool_), 0.5) is None
    with pytest.raises(ValueError, match=f"the method {method} makes no forecasts"):
        controller.along(np.zeros((12, 2)), [12])


def test_measure_and_hold_corrects_by_the_last_measurement_and_asks_at_its_interval() -> None:
    controller = Controller(INPUTS, settings("hold"), strategy=own("hold"))
    held, wanted = np.full(9, np.nan), []
    for frame in day(20):
        before = held
        if frame.measurement is not None:
            held = frame.measurement.errors
        decision = controller.step(frame)
        np.testing.assert_array_equal(decision.predicted, before)
        np.testing.assert_array_equal(decision.corrected, held)
        assert np.isnan(decision.sigma).all()
        wanted.append(decision.measure)
    assert decision.phase is Phase.COMPENSATION
    assert [k for k, why in enumerate(wanted) if why is Why.INTERVAL] == [15, 19]
    partly = Measurement(np.array([1.0, *[np.nan] * 8]), np.ones(9))
    decision = controller.step(replace(frame, k=30, measurement=partly))
    np.testing.assert_array_equal(decision.corrected, [1.0, *held[1:]])
    assert controller.step(Frame(31, heated(31), np.ones(2, dtype=np.bool_), None, pause_unknown=True)).measure


def test_an_interval_is_a_number_of_steps() -> None:
    with pytest.raises(ValueError, match="interval_steps = 0"):
        MeasureAndHold(0)
