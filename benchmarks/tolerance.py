"""What it saves that the limit follows the tolerance of what is machined, on simulated machines.

For three of four hours a machine roughs, where 10 µm are good enough; in the fourth it finishes to 3 µm. The program
states which ten minutes ahead. Beside it are limits that stay the same. What counts is how many measurements leave an
equal 99th percentile of the residual while finishing, and of the residual over the tolerance at all times.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np

from benchmarks.data import machine_days
from benchmarks.learner import MACHINES
from benchmarks.rows import BenchRow
from talc.control import Controller
from talc.frame import BoolArray, FloatArray, Frame, Measurement
from talc.settings import LearnerSettings, TalcSettings

HOURS, _HOUR, _POSITIONS = 72, 12, 6
ROUGH_UM, FINE_UM = 10.0, 3.0
_AHEAD_STEPS = 2
_LIMITS_UM = (3.0, 4.0, 5.0, 7.0, 10.0)
_MACHINES = MACHINES[1::4]


@dataclass(frozen=True, slots=True)
class Kept:
    """What one way of limiting left after the first day."""

    measurements: int
    over_tolerance: float
    """P99 of the residual over the tolerance, of all position errors together."""
    fine_um: float
    """P99 of the residual while finishing, µm; `rough_um` otherwise."""
    rough_um: float


def is_fine(steps: int) -> BoolArray:
    """(T,) whether it is finishing: the last hour of each four."""
    return np.asarray(np.arange(steps) // _HOUR % 4 == 3)


def kept(kind: str, seed: int, limit_um: float | None, hours: int = HOURS) -> Kept:
    """One machine. limit_um: stays the same; None: it follows what the program states."""
    m = machine_days(kind, seed, hours)
    fine = is_fine(len(m.inputs) + _AHEAD_STEPS)
    tolerance = np.where(fine, FINE_UM, ROUGH_UM)
    settings = LearnerSettings(limit_um=limit_um or FINE_UM)
    if limit_um is None:
        settings = LearnerSettings(limit_um=FINE_UM, least_limit_um=FINE_UM, most_limit_um=ROUGH_UM)
    controller = Controller(m.names, TalcSettings(learner=settings))
    valid, wanted, made = np.ones(len(m.names), dtype=np.bool_), True, 0
    left, first_day = np.zeros((len(m.inputs), _POSITIONS)), 24 * _HOUR
    for k, row in enumerate(m.inputs):
        measurement = Measurement(m.measured[k], m.sigma) if wanted else None
        made += wanted and k >= first_day
        decision = controller.step(Frame(k, row, valid, measurement, tolerance_um=tolerance[k + _AHEAD_STEPS]))
        left[k] = (m.truth[k] - np.nan_to_num(decision.predicted))[:_POSITIONS]
        wanted = decision.measure is not None
    now, after = fine[: len(left)], np.arange(len(left)) >= first_day

    def p99(values: FloatArray) -> float:
        return float(np.quantile(np.abs(values), 0.99))

    return Kept(
        made,
        p99(left[after] / tolerance[: len(left)][after, None]),
        p99(left[after & now]),
        p99(left[after & ~now]),
    )


def saved(following: Kept, same: Sequence[Kept], left: Callable[[Kept], float]) -> float:
    """Measurements over those of a limit that stays the same and leaves as much; NaN: none of these does."""
    order = sorted(same, key=left)
    each, own = [left(one) for one in order], left(following)
    if not each[0] <= own <= each[-1]:
        return float("nan")
    return following.measurements / float(np.interp(own, each, [one.measurements for one in order]))


def _of_machine(kind: str, seed: int) -> list[Kept]:
    return [kept(kind, seed, limit) for limit in (None, *_LIMITS_UM)]


def rows() -> list[BenchRow]:
    """All rows of the table; takes a minute."""
    with ProcessPoolExecutor() as pool:
        found = list(pool.map(_of_machine, *zip(*_MACHINES, strict=True)))
    table = []
    for i, limit in enumerate((None, *_LIMITS_UM)):
        each = [of_machine[i] for of_machine in found]
        name = "limit follows 3 and 10 µm, of four machines" if limit is None else f"limit {limit:g} µm"
        table.append(
            BenchRow(
                f"{name}: measurements in 48 h",
                f"{np.median([e.measurements for e in each]):.0f}",
                f"P99 {np.median([e.fine_um for e in each]):.1f} µm while finishing, "
                f"{np.median([e.rough_um for e in each]):.1f} otherwise",
            )
        )
    ways: dict[str, Callable[[Kept], float]] = {
        "P99 while finishing": lambda each: each.fine_um,
        "P99 over the tolerance at all times": lambda each: each.over_tolerance,
    }
    for name, left in ways.items():
        ratios = np.array([saved(following, same, left) for following, *same in found])
        known = ratios[np.isfinite(ratios)]
        text = f"{np.median(known):.2f} ({known.min():.2f} to {known.max():.2f})" if known.size else "–"
        table.append(BenchRow(f"measurements over those of one limit at equal {name}", text, f"{known.size} machines"))
    return table
