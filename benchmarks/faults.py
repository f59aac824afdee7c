"""Values that are none, put into a recording and into simulated machines: what they leave, an hour after their end.

Each row is one fault: the error left over that of the same run without the fault, of all errors together and of the
worst one, from an hour after its end; and what the controller said of it. Faults come in the dense beginning, and when
the machine is measured rarely. The columns that they hit are the input that varies most, the one in the middle and the
one that varies least, and the first error.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from benchmarks.data import machine_days
from benchmarks.learner import day_then_every
from benchmarks.recordings.judge import rows_to_measure
from benchmarks.recordings.methods import given_of
from benchmarks.recordings.series import read_series
from benchmarks.recordings.subject import SHIPPED
from benchmarks.rows import BenchRow
from talc.control import Controller
from talc.frame import Event, EventCode, FloatArray, Frame, IntArray, Measurement
from talc.names import THERMAL_ERRORS
from talc.settings import TalcSettings

_SETTINGS = TalcSettings(method="learner")
_HOUR = 12
_ERRORS = len(THERMAL_ERRORS)
_VARIES = 0.2
_SAID = frozenset(
    {
        EventCode.VALUE_IMPLAUSIBLE,
        EventCode.INPUTS_EXCHANGED,
        EventCode.NO_MEASUREMENT,
        EventCode.TAKEN_BACK,
        EventCode.OUTLIER,
    }
)
MACHINES = (("day", 1), ("axes", 3))
Change = Callable[[FloatArray, FloatArray, Sequence[int]], None]
"""Changes (rows, n) inputs and (rows, m) measurements in place; the inputs' places by their spread."""


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """A machine at its rows of five minutes."""

    names: tuple[str, ...]
    k: IntArray
    inputs: FloatArray
    """(T, n)"""
    truth: FloatArray
    """(T, m)"""
    measured: FloatArray
    """(T, m); NaN where nothing was measured."""
    sigma: FloatArray
    """(m,)"""

    @property
    def by_spread(self) -> list[int]:
        """Inputs that may be temperatures or lengths, the one that varies most first."""
        spread = np.nanstd(self.inputs, axis=0)
        order = np.argsort(-spread, kind="stable").tolist()
        return [i for i in order if _VARIES < spread[i] < 60.0]


def recording(dense_h: float = 12.0, interval_min: float = 60.0) -> Measured:
    """The recording that the project ships."""
    said, series = read_series(SHIPPED / "fl_thermal.toml")
    used = rows_to_measure(series, dense_h, interval_min)
    given = given_of(series, used, said.seed, round(dense_h * _HOUR), round(interval_min / 5.0))
    return Measured(series.input_names, series.k, series.inputs, series.truth, given.measured, given.sigma)


def machine(kind: str, seed: int) -> Measured:
    """A simulated one, for two days: measured each ten minutes on the first, hourly on the second."""
    m = machine_days(kind, seed, 48)
    used = day_then_every(2, _HOUR, len(m.inputs))
    measured = np.where(used[:, None], m.measured, np.nan)
    return Measured(m.names, np.arange(len(m.inputs)), m.inputs, m.truth, measured, m.sigma)


@dataclass(frozen=True, slots=True)
class Fault:
    """What happens to a machine's values from a row on."""

    name: str
    rows: int
    """How long it lasts."""
    change: Change

    def put_into(self, m: Measured, begin: int) -> Measured:
        """The machine with it."""
        inputs, measured = m.inputs.copy(), m.measured.copy()
        there = slice(begin, begin + self.rows)
        self.change(inputs[there], measured[there], m.by_spread)
        return replace(m, inputs=inputs, measured=measured)


def _cells(value: float, which: int) -> Change:
    """Ten single cells."""

    def change(x: FloatArray, _: FloatArray, places: Sequence[int]) -> None:
        rows = np.random.default_rng(1).choice(len(x), 10, replace=False)
        x[rows, places[which * (len(places) - 1) // 2]] = value

    return change


def _input(f: Callable[[FloatArray], FloatArray], which: int) -> Change:
    def change(x: FloatArray, _: FloatArray, places: Sequence[int]) -> None:
        column = places[which * (len(places) - 1) // 2]
        x[:, column] = f(x[:, column])

    return change


def _error(f: Callable[[FloatArray], FloatArray]) -> Change:
    def change(_: FloatArray, y: FloatArray, __: Sequence[int]) -> None:
        y[:, 0] = np.where(np.isfinite(y[:, 0]), f(y[:, 0]), np.nan)

    return change


def _exchange(one: int, other: int) -> Change:
    def change(x: FloatArray, _: FloatArray, places: Sequence[int]) -> None:
        pair = [places[which * (len(places) - 1) // 2] for which in (one, other)]
        x[:, pair] = x[:, pair[::-1]]

    return change


FAULTS = (
    Fault("85 °C in ten cells", 4 * _HOUR, _cells(85.0, 0)),
    Fault("-127 °C in ten cells", 4 * _HOUR, _cells(-127.0, 1)),
    Fault("85 °C for four hours", 4 * _HOUR, _input(lambda v: np.full_like(v, 85.0), 0)),
    Fault("-127 °C for an hour", _HOUR, _input(lambda v: np.full_like(v, -127.0), 1)),
    Fault("an input in °F for four hours", 4 * _HOUR, _input(lambda v: 32.0 + 1.8 * v, 0)),
    Fault("an input in 0.1 °C for four hours", 4 * _HOUR, _input(lambda v: 10.0 * v, 1)),
    Fault("an input frozen for eight hours", 8 * _HOUR, _input(lambda v: np.full_like(v, v[0]), 0)),
    Fault("two inputs exchanged for four hours", 4 * _HOUR, _exchange(0, 1)),
    Fault("two others exchanged for four hours", 4 * _HOUR, _exchange(0, 2)),
    Fault("an error at 99.999 for four hours", 4 * _HOUR, _error(lambda v: np.full_like(v, 99.999))),
    Fault("an error in mm for four hours", 4 * _HOUR, _error(lambda v: v / 1000.0)),
    Fault("an error in nm for an hour", _HOUR, _error(lambda v: v * 1000.0)),
)


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """What the controller predicted before each measurement, and what it said of values."""

    left: FloatArray
    """(T, m) truth minus prediction."""
    said: tuple[str, ...]
    """`column: fault`, one for each time it was said."""


def run(m: Measured) -> Course:
    """The learner with its default settings."""
    controller, errors = Controller(m.names, _SETTINGS), m.truth.shape[1]
    predicted, said = np.zeros(m.truth.shape), []
    for row, k in enumerate(m.k.tolist()):
        measurement = None
        if np.isfinite(m.measured[row]).any():
            values, sigma = np.full((2, _ERRORS), np.nan)
            values[:errors], sigma[:errors] = m.measured[row], m.sigma
            measurement = Measurement(values, sigma)
        decision = controller.step(Frame(k, m.inputs[row], np.isfinite(m.inputs[row]), measurement))
        predicted[row] = np.nan_to_num(decision.predicted[:errors])
        said += [_said(event) for event in decision.events if event.code in _SAID]
    return Course(m.truth - predicted, tuple(said))


def _said(event: Event) -> str:
    values = event.values
    return f"{event.error or values['input']}: {values.get('input_fault', values.get('measurement_fault', event.code))}"


def left_over(m: Measured, course: Course, after: int) -> FloatArray:
    """(m + 1,) RMS of what is left from a row on, where nothing was measured: of each error, and of all."""
    judged = np.flatnonzero(~np.isfinite(m.measured).any(axis=1))
    square = course.left[judged[judged >= after]] ** 2
    return np.asarray(np.sqrt(np.append(np.nanmean(square, axis=0), np.nanmean(square))))


def ratios(m: Measured, clean: Course, fault: Fault, begin: int) -> tuple[float, float, dict[str, int]]:
    """An hour after its end: all errors, the worst error, and what was said more often than without it."""
    course = run(fault.put_into(m, begin))
    after = begin + fault.rows + _HOUR
    over = left_over(m, course, after) / left_over(m, clean, after)
    told = {word: course.said.count(word) - clean.said.count(word) for word in dict.fromkeys(course.said)}
    return float(over[-1]), float(over[:-1].max()), {word: n for word, n in told.items() if n > 0}


def _of_machine(kind: str, seed: int) -> list[tuple[str, str, float, float, dict[str, int]]]:
    is_recorded = kind == "fl_thermal"
    m = recording() if is_recorded else machine(kind, seed)
    name, clean = kind if is_recorded else f"{kind} {seed}", run(m)
    begins = 6 * _HOUR, (20 if is_recorded else 25) * _HOUR
    return [(name, fault.name, *ratios(m, clean, fault, begin)) for fault, begin in product(FAULTS, begins)]


def rows() -> list[BenchRow]:
    """Each fault on each machine."""
    with ProcessPoolExecutor() as pool:
        of_each = pool.map(_of_machine, *zip(("fl_thermal", 0), *MACHINES, strict=True))
        found = [each for part in of_each for each in part]
    table = []
    for fault in FAULTS:
        own = [each for each in found if each[1] == fault.name]
        every = ", ".join(f"{over:.2f} ({worst:.2f})" for _, _, over, worst, _ in own)
        said = "; ".join(
            dict.fromkeys(f"{name}: {word} {n}x" for name, _, _, _, told in own for word, n in told.items())
        )
        table.append(BenchRow(f"{fault.name}: error left over that without it, worst error", every, said))
    return table
