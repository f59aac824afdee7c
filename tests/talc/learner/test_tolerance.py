"""The limits follow the tolerance that is stated for what comes next, within declared bounds."""

import numpy as np
import pytest

from talc.control import Controller
from talc.frame import Decision, Event, EventKind, Frame, Frames, Measurement, Why
from talc.settings import LearnerSettings, TalcSettings
from talc.snapshot import from_plain, to_plain
from tests.benches.thermal_series import series

BOUNDED = LearnerSettings(limit_um=5.0, limit_um_per_m=15.0, least_limit_um=2.0, most_limit_um=20.0)


def stated(decision: Decision) -> list[Event]:
    return [event for event in decision.events if event.kind is EventKind.TOLERANCE_STATED]


def test_limits_follow_within_their_bounds_and_return_to_the_declared_ones() -> None:
    controller = Controller(("a",), TalcSettings(learner=BOUNDED))
    found = []
    for k, tolerance in enumerate([None, 8.0, None, 8.0, 1.0, 500.0, -3.0, float("nan"), 0.0]):
        decision = controller.step(Frame(k, np.array([20.0]), np.array([True]), tolerance_um=tolerance))
        found.append((float(decision.limits[0]), float(decision.limits[8]), len(stated(decision))))
    assert found == [
        (5.0, 15.0, 0), (8.0, 24.0, 1), (8.0, 24.0, 0), (8.0, 24.0, 0), (2.0, 6.0, 1), (20.0, 60.0, 1),
        (20.0, 60.0, 0), (20.0, 60.0, 0), (5.0, 15.0, 1),
    ]  # fmt: skip


def test_without_bounds_nothing_follows() -> None:
    controller = Controller(("a",), TalcSettings(learner=LearnerSettings()))
    decision = controller.step(Frame(0, np.array([20.0]), np.array([True]), tolerance_um=1.0))
    assert (decision.limits[0], stated(decision)) == (5.0, [])


def test_a_finer_tolerance_is_measured_for_before_it_counts_and_a_coarse_one_is_not() -> None:
    made = series(400, 3)
    wanted = {}
    for tolerance in (2.0, 20.0):
        controller = Controller(made.names, TalcSettings(learner=BOUNDED))
        measured = True
        for k in range(300):
            measurement = Measurement(made.measured[k], np.full(9, 0.5)) if measured else None
            frame = Frame(k, made.inputs[k], np.ones(len(made.names), dtype=np.bool_), measurement, tolerance_um=20.0)
            measured = controller.step(frame).measure is not None
        frame = Frame(300, made.inputs[300], np.ones(len(made.names), dtype=np.bool_), tolerance_um=tolerance)
        wanted[tolerance] = controller.step(frame).measure
    assert wanted == {2.0: Why.UNCERTAINTY, 20.0: None}


def test_a_snapshot_keeps_the_tolerance() -> None:
    settings = TalcSettings(learner=BOUNDED)
    controller = Controller(("a",), settings)
    frame = Frame(0, np.array([20.0]), np.array([True]), tolerance_um=3.0)
    controller.step(frame)
    plain, arrays = to_plain(controller.state())
    kept = Frames(np.array([0]), frame.inputs[None], frame.valid[None], np.full((1, 9), np.nan))
    restored = Controller.restore(from_plain(plain, arrays, lambda _, __: kept), settings)
    after = Frame(1, frame.inputs, frame.valid)
    assert restored.step(after).limits.tolist() == controller.step(after).limits.tolist() == [3.0] * 6 + [9.0] * 3


@pytest.mark.parametrize(
    ("given", "field"),
    [
        ({"least_limit_um": 2.0}, "most_limit_um"),
        ({"most_limit_um": 9.0}, "least_limit_um"),
        ({"least_limit_um": 6.0, "most_limit_um": 9.0}, "least_limit_um"),
        ({"least_limit_um": 2.0, "most_limit_um": 4.0}, "most_limit_um"),
        ({"least_limit_um": 0.0, "most_limit_um": 9.0}, "least_limit_um"),
    ],
)
def test_bounds_that_contradict_are_refused(given: dict[str, float], field: str) -> None:
    with pytest.raises(ValueError, match=field):
        LearnerSettings(**given)  # type: ignore[arg-type]
