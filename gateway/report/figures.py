"""Figures of a run: each error without and with compensation, and the basis of each figure."""

from dataclasses import dataclass, replace

import numpy as np
from rich.table import Table

from gateway.report.data import ReportData
from talc.frame import EventKind, FloatArray
from talc.indicators import peak_to_peak, productivity, reduction, rms
from talc.names import ERROR_UNITS, MICROMETRE, THERMAL_ERRORS

CYCLE_S = 120.0
"""Duration of a probing cycle (Z22)."""


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
    """With compensation: what remains after the estimate in force."""

    @property
    def reduction_pv(self) -> float:
        return reduction(self.e_pv, self.compensated_e_pv)

    @property
    def reduction_rms(self) -> float:
        return reduction(self.e_rms, self.compensated_e_rms)


@dataclass(frozen=True, slots=True)
class Summary:
    """All figures of a run."""

    basis: str
    rows: tuple[SummaryRow, ...]
    tool: tuple[SummaryRow, ...]
    """Tool to workpiece through the control, X Y Z; only where the truth is known."""
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


def summary(data: ReportData) -> Summary:
    """The figures over all times since corrections began. A run in which they never did has no rows."""
    first = data.judged_from
    time_s = data.time_s
    total_s = float(time_s[-1]) + data.step_s
    if first is None:
        return Summary(
            "no correction has begun", (), (), total_s / 3600, total_s / 3600, 0.0, 0, 0, 0, data.rejected_cycles
        )
    begin_s = float(time_s[first])
    if data.truth is not None:
        basis = "simulated truth each minute, against the estimate in force"
        rows = _rows(data.labels, *_against_truth(data, begin_s))
    elif data.recorded is not None:
        basis = "recorded instants, against what would have been in force before that instant's measurement"
        rows = _recorded(data, data.recorded[first:], data.predicted[first:])
    else:
        basis = "measured instants, against the prediction before each measurement"
        rows = _rows(data.labels, data.measured[first:], data.measured[first:] - data.predicted[first:])
    after = int(np.isfinite(data.measured[first:]).any(axis=1).sum())
    return Summary(
        basis=basis,
        rows=rows,
        tool=_tool(data, begin_s),
        hours=total_s / 3600,
        begin_hours=begin_s / 3600,
        productivity=productivity(after, CYCLE_S, total_s - begin_s),
        measurements=after,
        state_updates=data.count(EventKind.STATE_UPDATE),
        model_updates=sum(a.after_k >= data.k[first] for a in data.models),
        rejected_cycles=data.rejected_cycles,
        held=()
        if data.recorded is None or data.held is None
        else _recorded(data, data.recorded[first:], data.held[first:]),
    )


def _recorded(data: ReportData, errors: FloatArray, estimate: FloatArray) -> tuple[SummaryRow, ...]:
    """Of the errors that were recorded since corrections began."""
    return tuple(row for row in _rows(data.labels, errors, errors - estimate) if np.isfinite(row.e_pv))


def _against_truth(data: ReportData, begin_s: float) -> tuple[FloatArray, FloatArray]:
    """Truth, and truth minus the latest estimate at or before each of its instants."""
    truth = data.truth
    if truth is None:
        raise ValueError("data.truth is None")
    times, errors = truth.time_s, truth.errors
    use = (times >= begin_s) & (times <= data.time_s[-1] + data.step_s)
    in_force = np.searchsorted(data.time_s, times[use], side="right") - 1
    return errors[use], errors[use] - data.corrected[in_force]


def _rows(labels: tuple[str, ...], before: FloatArray, after: FloatArray) -> tuple[SummaryRow, ...]:
    return tuple(
        SummaryRow(label, ERROR_UNITS[n], peak_to_peak(b), rms(b), peak_to_peak(a), rms(a))
        for label, n, b, a in zip(labels, THERMAL_ERRORS, before.T, after.T, strict=True)
    )


def _tool(data: ReportData, begin_s: float) -> tuple[SummaryRow, ...]:
    truth = data.truth
    if truth is None:
        return ()
    use = (truth.time_s >= begin_s) & ~truth.probing
    return tuple(
        SummaryRow(f"tool {axis}", MICROMETRE, peak_to_peak(b), rms(b), peak_to_peak(a), rms(a))
        for axis, b, a in zip("XYZ", truth.uncompensated_um[use].T, truth.compensated_um[use].T, strict=True)
    )


def table(s: Summary) -> Table:
    """For a terminal."""
    caption = (
        f"Basis: {s.basis}; from {s.begin_hours:.1f} h on, when corrections began; {s.hours:.1f} h in all.\n"
        f"Productivity Pd {s.productivity:.1f} % ({s.measurements} measurements of {CYCLE_S:.0f} s), "
        f"{s.model_updates} model updates, {s.state_updates} state updates, {s.rejected_cycles} cycles rejected."
    )
    grid = Table(title="Thermal errors without and with compensation", caption=caption, caption_justify="left")
    for name in ("error", "unit", "E_PV", "comp.", "red. %", "E_RMS", "comp.", "red. %"):
        grid.add_column(name, justify="left" if name in ("error", "unit") else "right")
    held = tuple(replace(row, name=f"{row.name} held") for row in s.held)
    for row in (*s.rows, *held, *s.tool):
        figures = (
            f"{row.e_pv:.1f}", f"{row.compensated_e_pv:.1f}", f"{row.reduction_pv:.0f}",
            f"{row.e_rms:.2f}", f"{row.compensated_e_rms:.2f}", f"{row.reduction_rms:.0f}",
        )  # fmt: skip
        grid.add_row(row.name, row.unit, *figures, end_section=row in (s.rows[-1], *held[-1:]))
    return grid
