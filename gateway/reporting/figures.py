"""Figures of a run: each error without and with compensation, and the basis of each figure."""

from dataclasses import dataclass, replace

import numpy as np
from rich.table import Table

from gateway.reporting.data import ReportData
from gateway.reporting.tool import ToolCourse, at_tool
from talc.frame import EventKind, FloatArray
from talc.indicators import peak_to_peak, productivity, reduction, rms
from talc.names import ERROR_UNITS, MICROMETRE, THERMAL_ERRORS

CYCLE_S = 120.0
"""Duration of a probing cycle (Z22)."""
_LEAST_PERCENT = 0.5
_MOST_PERCENT = 100.0


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

    @property
    def within_noise(self) -> bool:
        """Whether a measurement can see neither the error nor what is left of it."""
        return max(self.e_rms, self.compensated_e_rms) <= self.noise

    @property
    def change_pv(self) -> str:
        return self._change(self.e_pv, self.compensated_e_pv)

    @property
    def change_rms(self) -> str:
        return self._change(self.e_rms, self.compensated_e_rms)

    def _change(self, before: float, after: float) -> str:
        """In words. A percentage of a tiny number says nothing, so a large increase is stated in the error's unit."""
        if self.within_noise:
            return "below the probing noise"
        percent = reduction(before, after)
        if not np.isfinite(percent):
            return "not known"
        if percent < -_MOST_PERCENT or (percent < 0 and self.e_rms <= self.noise):
            return f"{after - before:.1f} {self.unit} more"
        if abs(percent) < _LEAST_PERCENT:
            return "unchanged"
        return f"{abs(percent):.0f} % {'less' if percent > 0 else 'more'}"


@dataclass(frozen=True, slots=True)
class Summary:
    """All figures of a run."""

    basis: str
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
    course: ToolCourse | None = None
    """The deviations that `tool` is made of, from the first frame on; None: they cannot be known."""

    @property
    def tool_basis(self) -> str:
        """What the figures at the tool are made of, in words."""
        return self.course.basis if self.course is not None and self.rows else ""


def summary(data: ReportData) -> Summary:
    """The figures over all times since corrections began. A run in which they never did has no rows."""
    first, course = data.judged_from, at_tool(data)
    time_s = data.time_s
    total_s = float(time_s[-1]) + data.step_s
    if first is None:
        basis, hours = "no correction has begun", total_s / 3600
        return Summary(basis, (), (), hours, hours, 0.0, 0, 0, 0, data.rejected_cycles, course=course)
    begin_s = float(time_s[first])
    if data.truth is not None:
        basis = "simulated truth each minute, against the estimate of the latest grid step"
        rows = _rows(data, *_against_truth(data, begin_s))
    elif data.recorded is not None:
        basis = "recorded instants, against what would have been in force before that instant's measurement"
        rows = _recorded(data, data.recorded[first:], data.predicted[first:])
    else:
        basis = "measured instants, against the prediction before each measurement"
        rows = _rows(data, data.measured[first:], data.measured[first:] - data.predicted[first:])
    after = int(np.isfinite(data.measured[first:]).any(axis=1).sum())
    return Summary(
        basis=basis,
        rows=rows,
        tool=() if course is None else _tool(course, begin_s),
        course=course,
        hours=total_s / 3600,
        begin_hours=begin_s / 3600,
        # Cycles of a rehearsal are shorter than a cycle counts.
        productivity=max(productivity(after, CYCLE_S, total_s - begin_s), 0.0),
        measurements=after,
        state_updates=data.count(EventKind.STATE_UPDATE),
        model_updates=sum(a.after_k >= data.k[first] for a in data.models),
        rejected_cycles=data.rejected_cycles,
        held=()
        if data.recorded is None or data.held is None
        else _recorded(data, data.recorded[first:], data.held[first:]),
    )


def _recorded(data: ReportData, errors: FloatArray, estimate: FloatArray) -> tuple[SummaryRow, ...]:
    """Figures of the errors that were recorded since corrections began."""
    return tuple(row for row in _rows(data, errors, errors - estimate) if np.isfinite(row.e_pv))


def _against_truth(data: ReportData, begin_s: float) -> tuple[FloatArray, FloatArray]:
    """Truth, and truth minus the latest estimate at or before each of its instants."""
    truth = data.truth
    if truth is None:
        raise ValueError("data.truth is None")
    times, errors = truth.time_s, truth.errors
    use = (times >= begin_s) & data.truth_ran
    return errors[use], errors[use] - data.corrected[data.rows_at(times[use])]


def _rows(data: ReportData, before: FloatArray, after: FloatArray) -> tuple[SummaryRow, ...]:
    noise = np.full(len(THERMAL_ERRORS), np.nan) if data.noise is None else data.noise
    return tuple(
        SummaryRow(label, ERROR_UNITS[n], peak_to_peak(b), rms(b), peak_to_peak(a), rms(a), u)
        for label, n, b, a, u in zip(data.labels, THERMAL_ERRORS, before.T, after.T, noise.tolist(), strict=True)
    )


def _tool(course: ToolCourse, begin_s: float) -> tuple[SummaryRow, ...]:
    use = course.between(begin_s, float("inf"))
    rows = (
        SummaryRow(f"tool {axis}", MICROMETRE, peak_to_peak(b), rms(b), peak_to_peak(a), rms(a), course.noise)
        for axis, b, a in zip("XYZ", course.before[use].T, course.after[use].T, strict=True)
    )
    return tuple(row for row in rows if np.isfinite(row.e_rms))


def table(s: Summary) -> Table:
    """For a terminal."""
    caption = (
        f"Basis: {s.basis}; from {s.begin_hours:.1f} h on, when corrections began; {s.hours:.1f} h in all.\n"
        f"Productivity Pd {s.productivity:.1f} % since then. Measurements of {CYCLE_S:.0f} s: {s.measurements}; "
        f"model updates: {s.model_updates}; state updates: {s.state_updates}; cycles rejected: {s.rejected_cycles}."
    )
    grid = Table(title="Thermal errors without and with compensation", caption=caption, caption_justify="left")
    for name in ("error", "unit", "E_PV", "comp.", "change", "E_RMS", "comp.", "change"):
        grid.add_column(name, justify="left" if name in ("error", "unit") else "right")
    held = tuple(replace(row, name=f"{row.name} held") for row in s.held)
    for row in (*s.rows, *held, *s.tool):
        figures = (
            f"{row.e_pv:.1f}", f"{row.compensated_e_pv:.1f}", row.change_pv,
            f"{row.e_rms:.2f}", f"{row.compensated_e_rms:.2f}", row.change_rms,
        )  # fmt: skip
        grid.add_row(row.name, row.unit, *figures, end_section=row in (s.rows[-1], *held[-1:]))
    return grid
