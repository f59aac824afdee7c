"""Figures of a run: each error without and with compensation, and the basis of each figure."""

from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from rich.table import Table

from gateway.model.text import Language
from gateway.reporting.data import CYCLE_S, ReportData, cycle_s
from gateway.reporting.tool import ToolCourse, at_tool
from talc.frame import BoolArray, EventKind, FloatArray
from talc.indicators import FIRST_HOUR_S, Spread, productivity, reduction
from talc.names import ERROR_UNITS, MICROMETRE, THERMAL_ERRORS

_LEAST_PERCENT = 0.5
_LEAST_VALUES = 2
"""E_PV of a single value is 0, whatever it is."""
_MOST_PERCENT = 100.0


class Change(NamedTuple):
    """What the compensation did to an error."""

    kind: Literal["noise", "unknown", "unchanged", "more", "percent_less", "percent_more"]
    by: float = float("nan")
    unit: str = ""

    @property
    def sense(self) -> str:
        """`good`, `bad` or neither."""
        return {"percent_less": "good", "percent_more": "bad", "more": "bad"}.get(self.kind, "")

    def written(self, said: Language) -> str:
        """In words."""
        return said(f"report_change.{self.kind}", by=self.by, unit=self.unit)


@dataclass(frozen=True, slots=True)
class SummaryRow:
    """One error or direction, since corrections began."""

    name: str
    unit: str
    e_pv: float
    e_rms: float
    """Without compensation: the error itself, relative to the reference measurement."""
    compensated_e_pv: float
    compensated_e_rms: float
    """With compensation: what remains after the estimate of the latest grid step."""
    noise: float = float("nan")
    """Standard uncertainty of one measurement; NaN: unknown."""
    axis: str = ""
    """X, Y or Z at the tool; empty: it is a thermal error."""
    period: Literal["", "first_hour", "later"] = ""
    """Of which these figures are; empty: the whole time."""
    parts: tuple["SummaryRow", ...] = ()
    """The first hour and the rest; none while there is only one of them."""

    def written(self, said: Language) -> str:
        """Its name, or the period's."""
        if self.period:
            return said(f"report_period.{self.period}")
        return said("report.tool", axis=self.axis) if self.axis else self.name

    @property
    def within_noise(self) -> bool:
        """Whether a measurement can see neither the error nor what is left of it."""
        return max(self.e_rms, self.compensated_e_rms) <= self.noise

    @property
    def change_pv(self) -> Change:
        return self._change(self.e_pv, self.compensated_e_pv)

    @property
    def change_rms(self) -> Change:
        return self._change(self.e_rms, self.compensated_e_rms)

    def _change(self, before: float, after: float) -> Change:
        """A percentage of a tiny number says nothing, so a large increase is stated in the error's unit."""
        if self.within_noise:
            return Change("noise")
        percent = reduction(before, after)
        if not np.isfinite(percent):
            return Change("unknown")
        if percent < -_MOST_PERCENT or (percent < 0 and self.e_rms <= self.noise):
            return Change("more", after - before, self.unit)
        if abs(percent) < _LEAST_PERCENT:
            return Change("unchanged")
        return Change("percent_less" if percent > 0 else "percent_more", abs(percent))


@dataclass(frozen=True, slots=True)
class Summary:
    """All figures of a run."""

    basis: Literal["nothing", "simulated", "recorded", "measured"]
    """What the figures are made of."""
    rows: tuple[SummaryRow, ...]
    tool: tuple[SummaryRow, ...]
    """Tool to workpiece, X Y Z: in a simulation through the control; of a gateway at the sphere, as measured."""
    hours: float
    begin_hours: float
    """When corrections began: with the learner's first measurement, or with the first models."""
    productivity: float
    """Pd since then, %."""
    measurements: int
    """Since then."""
    state_updates: int
    model_updates: int
    rejected_cycles: int
    held: tuple[SummaryRow, ...] = ()
    """For comparison: the same measurements with the last one held; only for a recording."""
    cycle_s: float = CYCLE_S
    """Duration of a probing cycle, the median of those that were timed."""
    course: ToolCourse | None = None
    """The deviations that `tool` is made of, from the first frame on; None: they cannot be known."""


def summary(data: ReportData) -> Summary:
    """The figures over all times since corrections began. A run in which they never did has no rows."""
    first, course = data.judged_from, at_tool(data)
    time_s = data.time_s
    total_s = float(time_s[-1]) + data.step_s
    if first is None:
        hours = total_s / 3600
        return Summary("nothing", (), (), hours, hours, 0.0, 0, 0, 0, data.rejected_cycles, course=course)
    begin_s = float(time_s[first])
    since_s = time_s[first:] - begin_s
    basis: Literal["simulated", "recorded", "measured"]
    if data.truth is not None:
        basis = "simulated"
        rows = _rows(data, *_against_truth(data, begin_s))
    elif data.recorded is not None:
        basis = "recorded"
        rows = _recorded(data, since_s, data.recorded[first:], data.predicted[first:])
    else:
        basis = "measured"
        rows = _rows(data, since_s, data.measured[first:], data.measured[first:] - data.predicted[first:])
    after = int(np.isfinite(data.measured[first:]).any(axis=1).sum())
    return Summary(
        basis=basis,
        rows=rows,
        tool=() if course is None else _tool(course, begin_s),
        course=course,
        hours=total_s / 3600,
        begin_hours=begin_s / 3600,
        # Cycles of a rehearsal may be shorter than the time between them.
        productivity=max(productivity(after, cycle_s(data.cycles_seen), total_s - begin_s), 0.0),
        cycle_s=cycle_s(data.cycles_seen),
        measurements=after,
        state_updates=data.count(EventKind.STATE_UPDATE),
        model_updates=sum(bool(a.after_k >= data.k[first]) for a in data.models),
        rejected_cycles=data.rejected_cycles,
        held=()
        if data.recorded is None or data.held is None
        else _recorded(data, since_s, data.recorded[first:], data.held[first:]),
    )


def _recorded(
    data: ReportData, since_s: FloatArray, errors: FloatArray, estimate: FloatArray
) -> tuple[SummaryRow, ...]:
    """Figures of the errors that were recorded since corrections began."""
    return tuple(row for row in _rows(data, since_s, errors, errors - estimate) if np.isfinite(row.e_pv))


def _against_truth(data: ReportData, begin_s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Times since then; truth; and truth minus the latest estimate at or before each of its instants."""
    truth = data.truth
    if truth is None:
        raise ValueError("data.truth is None")
    times, errors = truth.time_s, truth.errors
    use = (times >= begin_s) & data.truth_ran
    return times[use] - begin_s, errors[use], errors[use] - data.corrected[data.rows_at(times[use])]


def _row(
    label: str, unit: str, course: tuple[FloatArray, FloatArray, FloatArray], noise: float, axis: str = ""
) -> SummaryRow:
    """course: (m,) times since corrections began, and one error or direction without and with compensation."""
    since_s, before, after = course

    def figures(use: BoolArray, period: Literal["", "first_hour", "later"]) -> SummaryRow:
        without, left = Spread.of(before[use]), Spread.of(after[use])
        return SummaryRow(label, unit, without.pv, without.rms, left.pv, left.rms, noise, axis, period)

    known, early = np.isfinite(after), since_s < FIRST_HOUR_S
    whole = figures(np.ones(len(known), dtype=np.bool_), "")
    if min(int((known & early).sum()), int((known & ~early).sum())) < _LEAST_VALUES:
        return whole
    return replace(whole, parts=(figures(early, "first_hour"), figures(~early, "later")))


def _rows(data: ReportData, since_s: FloatArray, before: FloatArray, after: FloatArray) -> tuple[SummaryRow, ...]:
    noise = np.full(len(THERMAL_ERRORS), np.nan) if data.noise is None else data.noise
    return tuple(
        _row(label, ERROR_UNITS[n], (since_s, b, a), u)
        for label, n, b, a, u in zip(data.labels, THERMAL_ERRORS, before.T, after.T, noise.tolist(), strict=True)
    )


def _tool(course: ToolCourse, begin_s: float) -> tuple[SummaryRow, ...]:
    use = course.between(begin_s, float("inf"))
    rows = (
        _row(f"tool {axis}", MICROMETRE, (course.time_s[use] - begin_s, b, a), course.noise, axis)
        for axis, b, a in zip("XYZ", course.before[use].T, course.after[use].T, strict=True)
    )
    return tuple(row for row in rows if np.isfinite(row.e_rms))


def table(s: Summary, said: Language) -> Table:
    """For a terminal."""
    caption = said(
        "report.table_caption",
        basis=said(f"report_basis.{s.basis}"), begin_h=s.begin_hours, hours=s.hours, productivity=s.productivity,
        cycle_s=s.cycle_s, measurements=s.measurements, models=s.model_updates, states=s.state_updates,
        rejected=s.rejected_cycles,
    )  # fmt: skip
    grid = Table(title=said("report.table_title"), caption=caption, caption_justify="left")
    for name in ("error", "unit", "pv", "left", "change", "rms", "left", "change"):
        grid.add_column(said(f"report_column.{name}"), justify="left" if name in ("error", "unit") else "right")
    ends = {id((rows[-1], *rows[-1].parts)[-1]) for rows in (s.rows, s.held) if rows}
    named = [(row.written(said), row) for row in (*s.rows, *s.tool)]
    named[len(s.rows) : len(s.rows)] = [(said("report.held", name=row.name), row) for row in s.held]
    lines = [line for name, row in named for line in ((name, row), *((f"  {p.written(said)}", p) for p in row.parts))]
    for name, row in lines:
        figures = (
            said.number(row.e_pv, ".1f"), said.number(row.compensated_e_pv, ".1f"), row.change_pv.written(said),
            said.number(row.e_rms, ".2f"), said.number(row.compensated_e_rms, ".2f"), row.change_rms.written(said),
        )  # fmt: skip
        grid.add_row(name, row.unit, *figures, end_section=id(row) in ends)
    return grid
