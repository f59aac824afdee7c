"""Values that are none, of inputs and of measurements: named, and of no consequence an hour later."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from talc.control import Controller
from talc.frame import Event, EventCode, Frame, Measurement
from talc.learner.plausible import InputFault, strange_cells
from talc.settings import TalcSettings
from tests.benches.thermal_series import ThermalSeries, series

Array = NDArray[np.float64]
SETTINGS = TalcSettings(method="learner")
SIGMA, ALL = np.full(9, 0.5), np.ones(12, dtype=np.bool_)
BEGIN, END, ROWS, HOUR = 200, 248, 360, 12
SAID = (EventCode.VALUE_IMPLAUSIBLE, EventCode.INPUTS_EXCHANGED, EventCode.NO_MEASUREMENT, EventCode.TAKEN_BACK)
Change = Callable[[Array, Array], None]
"""Of (rows, 12) inputs and (rows, 9) measurements, in place."""


@pytest.fixture(scope="module")
def days() -> ThermalSeries:
    """Measured each quarter of an hour at first, then each half hour."""
    return series(ROWS, 3)


def run(days: ThermalSeries, change: Change | None = None) -> tuple[Array, list[tuple[int, Event]]]:
    """Truth minus prediction, (T, 9), and what was said of values."""
    inputs, measured = days.inputs.copy(), (days.measured - days.truth[0]).copy()
    if change is not None:
        change(inputs[BEGIN:END], measured[BEGIN:END])
    controller, said = Controller(days.names, SETTINGS), []
    left = np.zeros((ROWS, 9))
    for k in range(ROWS):
        measurement = Measurement(measured[k], SIGMA) if k % (3 if k < 144 else 6) == 0 else None
        decision = controller.step(Frame(k, inputs[k], ALL, measurement))
        left[k] = days.truth[k] - days.truth[0] - np.nan_to_num(decision.predicted)
        said += [(k, event) for event in decision.events if event.code in SAID]
    return left, said


@pytest.fixture(scope="module")
def clean(days: ThermalSeries) -> Array:
    left, said = run(days)
    assert not said, "a healthy machine has none"
    return left


def ten_cells(x: Array, _: Array) -> None:
    x[::5, 0] = 85.0


def no_sensor(x: Array, _: Array) -> None:
    x[:12, 0] = -127.0


def fahrenheit(x: Array, _: Array) -> None:
    x[:, 0] = 1.8 * x[:, 0] + 32.0


def tenths(x: Array, _: Array) -> None:
    x[:, 3] *= 10.0


def stuck(_: Array, y: Array) -> None:
    y[:, 0] = 99.999


def in_nm(_: Array, y: Array) -> None:
    y[:, 0] *= 1000.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "column", "fault"),
    [
        (ten_cells, "t0", "power_on"),
        (no_sensor, "t0", "no_sensor"),
        (fahrenheit, "t0", "fahrenheit"),
        (tenths, "t3", "tenths"),
        (stuck, "EY0A", "stuck"),
        (in_nm, "EY0A", "thousandfold"),
    ],
)
def test_a_fault_is_named_and_forgotten_within_an_hour(
    days: ThermalSeries, clean: Array, change: Change, column: str, fault: str
) -> None:
    left, said = run(days, change)
    named = {
        e.error or e.values["input"]: e.values.get("input_fault", e.values.get("measurement_fault")) for _, e in said
    }
    assert named[column] == fault
    assert all(BEGIN <= k < END + HOUR for k, _ in said)
    over = np.sqrt(np.mean(left[END + HOUR :] ** 2, axis=0) / np.mean(clean[END + HOUR :] ** 2, axis=0))
    assert over.max() < 1.3


@pytest.mark.slow
def test_a_single_cell_hardly_moves_the_correction(days: ThermalSeries, clean: Array) -> None:
    left, _ = run(days, ten_cells)
    assert np.abs(left[BEGIN:END] - clean[BEGIN:END]).max() < 2.0


@pytest.mark.slow
def test_measurements_of_a_bad_day_are_forgotten_at_the_first_good_one(days: ThermalSeries, clean: Array) -> None:
    """As with a probe that sits wrong: they differ, so that nothing tells that they are none."""

    def shifted(_: Array, y: Array) -> None:
        y[:, 0] += 60.0

    left, said = run(days, shifted)
    assert [(e.error, e.code) for k, e in said if k >= END] == [("EY0A", EventCode.TAKEN_BACK)]
    after = slice(END + HOUR, None)
    assert np.sqrt(np.mean(left[after, 0] ** 2)) < 1.3 * np.sqrt(np.mean(clean[after, 0] ** 2))


@pytest.mark.slow
def test_exchanged_inputs_are_named_and_taken_for_each_other(days: ThermalSeries, clean: Array) -> None:
    far = int(np.argmax(np.abs(days.inputs[BEGIN - 1] - days.inputs[BEGIN - 1, 0])))

    def exchanged(x: Array, _: Array) -> None:
        x[:, [0, far]] = x[:, [far, 0]]

    left, said = run(days, exchanged)
    assert [(k, {e.values["input"], e.values["other"]}) for k, e in said] == [(BEGIN, {"t0", f"t{far}"})]
    np.testing.assert_allclose(left, clean, atol=1e-6)


@pytest.mark.parametrize("size", [8.0, 40.0], ids=["coolant on a sensor", "a hot chip"])
def test_a_fast_change_is_no_fault(days: ThermalSeries, size: float) -> None:
    def hot(x: Array, _: Array) -> None:
        x[:, 0] += size

    assert not [e for _, e in run(days, hot)[1] if e.code in SAID[:2]]


def test_a_spindle_that_first_starts_is_no_fault() -> None:
    """A state that stood still, and one with noise: 85 to the last digit, and ten times as much."""
    draw, said = np.random.default_rng(0), []
    controller = Controller(("rpm", "watt", "t0"), SETTINGS)
    for k in range(120):
        on = k >= 80
        inputs = np.array([85.0 if on else 0.0, (2000.0 if on else 200.0) + draw.normal(0, 5.0), 20.0 + 0.01 * k])
        decision = controller.step(Frame(k, inputs, np.ones(3, dtype=np.bool_), Measurement(np.zeros(9), SIGMA)))
        said += [event for event in decision.events if event.code in SAID]
    assert not said


def test_a_restart_within_a_fault_decides_as_no_restart(days: ThermalSeries) -> None:
    inputs, measured = days.inputs.copy(), (days.measured - days.truth[0]).copy()
    inputs[90:130, 0], inputs[100:130, 1] = 1.8 * inputs[90:130, 0] + 32.0, 85.0
    measured[90:130, 0] += 60.0
    whole = Controller(days.names, SETTINGS)

    def frame(k: int) -> Frame:
        return Frame(k, inputs[k], ALL, Measurement(measured[k], SIGMA) if k % 4 == 0 else None)

    for k in range(118):
        whole.step(frame(k))
    again = Controller.restore(whole.state(), SETTINGS)
    for k in range(118, 160):
        a, b = whole.step(frame(k)), again.step(frame(k))
        for name in ("predicted", "corrected", "sigma", "trusted"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
        assert a.events == b.events


def test_strange_cells_of_a_recording_are_counted_by_column(days: ThermalSeries) -> None:
    inputs = days.inputs.copy()
    ten_cells(inputs[BEGIN:END], inputs)
    inputs[260:290, 3] *= 10.0
    found = strange_cells(days.names, inputs, np.arange(ROWS), 300.0)
    assert [(cells.input, cells.fault, cells.first, cells.count) for cells in found] == [
        ("t0", InputFault.POWER_ON, BEGIN, 10),
        ("t3", InputFault.TENTHS, 260, 30),
    ]
