"""The first lines of a report: how much better the machine is, and what that cost."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gateway.reporting.data import CycleSeen, ReportData
from gateway.reporting.figures import CYCLE_S, Summary, SummaryRow
from gateway.reporting.local import hours, shifts_between
from talc.frame import FloatArray
from talc.indicators import productivity, rms
from talc.names import ERROR_UNITS, THERMAL_ERRORS

_MOST_SHIFTS = 42
"""Two weeks of three shifts a day."""
_STEP_AT_MOST_S = 900.0
"""A step of the compensation counts for no longer than this: after it the gateway was not running."""


@dataclass(frozen=True, slots=True)
class ShiftRow:
    """One shift, as texts."""

    when: str
    before: str
    after: str
    change: str
    cycles: str
    probing: str


def verdict(data: ReportData, s: Summary) -> str:
    """Such as `Z at the tool: 40 → 3.6 µm RMS, 91 % less, 96 % productive`; of the worst axis, or the worst error."""
    worst = _worst(s)
    if worst is None:
        return f"Nothing to judge yet: {'no measurement had a prediction before it' if s.rows else s.basis}"
    where = f"{worst.name.removeprefix('tool ')} at the tool" if s.tool else worst.name
    told = f"{where}: {_short(worst.e_rms)} → {_short(worst.compensated_e_rms)} {worst.unit} RMS, {worst.change_rms}"
    return told if data.recorded is not None else f"{told}, {_productive(data):.0f} % productive"


def losses(data: ReportData, s: Summary) -> tuple[tuple[str, str], ...]:
    """What was lost: the kind of loss, and how much."""
    found = [*_probing(data), *_gaps(data), *_stale(data)]
    if data.mode != "compensate" and data.recorded is None:
        told = f"[compensation] mode is '{data.mode}'" + (": the figures say what it would have left" if s.rows else "")
        found.append(("nothing was written to the control", told))
    worse = [
        f"{r.name} {before} → {after} {r.unit}"
        for r in (*s.tool, *s.rows)
        if r.compensated_e_rms > r.e_rms
        and not r.within_noise
        and (before := _short(r.e_rms)) != (after := _short(r.compensated_e_rms))
    ]
    if worse:
        found.append(("worse with compensation, RMS", ", ".join(worse)))
    held = {row.name: row.compensated_e_rms for row in s.held}
    beaten = [
        f"{r.name} {after} instead of {plain} {r.unit}"
        for r in s.rows
        if held.get(r.name, np.inf) < r.compensated_e_rms
        and not r.within_noise
        and (plain := _short(held[r.name])) != (after := _short(r.compensated_e_rms))
    ]
    if beaten:
        found.append(("worse than holding the last measurement, RMS", ", ".join(beaten)))
    return tuple(found)


def by_shift(data: ReportData, s: Summary) -> tuple[str, tuple[ShiftRow, ...]]:
    """What is judged, and the latest shifts; none of a recording, which says nothing of a machine's shifts."""
    worst, course = _worst(s), s.course
    if worst is None or data.recorded is not None:
        return "", ()
    axis = "XYZ".find(worst.name.removeprefix("tool "))
    if course is not None and axis >= 0:
        times, before, after = course.time_s, course.before[:, axis], course.after[:, axis]
        what = f"{'XYZ'[axis]} at the tool"
    else:
        e = data.labels.index(worst.name)
        times, before, after = data.time_s, data.measured[:, e], data.measured[:, e] - data.predicted[:, e]
        what = worst.name
    begin = data.start_utc_s + s.begin_hours * 3600.0
    end = data.start_utc_s + float(data.time_s[-1])  # when the last step ended: the shift that begins then has not run
    shifts = list(shifts_between(begin, end, data.shifts, data.zone))[-_MOST_SHIFTS:]
    return f"{what}, {worst.unit} RMS", tuple(
        _shift(
            data,
            worst,
            (max(first, begin) - data.start_utc_s, (last if last < end else np.inf) - data.start_utc_s),
            (times, before, after),
        )
        for first, last in shifts
    )


def _shift(
    data: ReportData,
    row: SummaryRow,
    between: tuple[float, float],
    course: tuple[FloatArray, FloatArray, FloatArray],
) -> ShiftRow:
    begin_s, end_s = between
    times, before, after = course
    use = (times >= begin_s) & (times < end_s)
    without, left = rms(before[use]), rms(after[use])
    seen = [cycle for cycle in data.cycles_seen if begin_s <= cycle.ended_s < end_s]
    refused = sum(bool(cycle.refused) for cycle in seen)
    known = SummaryRow(row.name, row.unit, without, without, left, left, row.noise)
    nothing = not np.isfinite(without)
    return ShiftRow(
        when=data.moment(begin_s),
        before="not measured" if nothing else _short(without),
        after="" if nothing else _short(left),
        change="" if nothing else known.change_rms,
        cycles=str(_many(seen)) + (f", {refused} refused" if refused else ""),
        probing=hours(_many(seen) * CYCLE_S),
    )


def _worst(s: Summary) -> SummaryRow | None:
    """The largest without compensation: at the tool, else of the positions, else of the orientations."""
    positions = [row for row in s.rows if row.unit == ERROR_UNITS[THERMAL_ERRORS[0]]]
    for rows in (s.tool, positions, s.rows):
        known = [row for row in rows if np.isfinite(row.e_rms) and np.isfinite(row.compensated_e_rms)]
        if known:
            return max(known, key=lambda row: row.e_rms)
    return None


def _productive(data: ReportData) -> float:
    """Share of the time in which no cycle ran, %; refused cycles and the reference's take time as well."""
    share = productivity(_many(data.cycles_seen), CYCLE_S, float(data.time_s[-1]) + data.step_s)
    return max(share, 0.0)  # a reference may take longer than the first steps


def _many(requests: Sequence[CycleSeen]) -> int:
    return sum(request.cycles for request in requests)


def _probing(data: ReportData) -> list[tuple[str, str]]:
    if not data.cycles_seen:
        return []
    many, share = _many(data.cycles_seen), 100.0 - _productive(data)
    cycles = f"{many} cycle{'' if many == 1 else 's'} of {CYCLE_S / 60:.0f} min"
    told = f"{cycles}, {hours(many * CYCLE_S)}, {share:.1f} % of the time"
    found = [("probing", told)]
    refused = [cycle.refused for cycle in data.cycles_seen if cycle.refused]
    if refused:
        found.append(("refused cycles", f"{len(refused)}; the last: {refused[-1]}"))
    return found


def _gaps(data: ReportData) -> list[tuple[str, str]]:
    missing = np.diff(data.k) - 1
    if data.recorded is not None or not missing.any():
        return []
    longest = int(np.argmax(missing))
    since = data.moment(float(data.time_s[longest]))
    many, lasted = int((missing > 0).sum()), hours(float(missing.sum()) * data.step_s)
    return [("gaps", f"{many}, {lasted} without a step; the longest {hours(missing[longest] * data.step_s)}, {since}")]


def _stale(data: ReportData) -> list[tuple[str, str]]:
    if data.stale is None or not data.stale.any():
        return []
    lasts = np.minimum(np.diff(data.compensation_s, append=data.compensation_s[-1]), _STEP_AT_MOST_S)
    begins = int(np.flatnonzero(np.diff(data.stale.astype(int), prepend=0) == 1).size)
    return [("stale", f"{hours(float(lasts[data.stale].sum()))} in {begins} periods without a usable prediction")]


def _short(value: float) -> str:
    """`40` or `3.6`."""
    return f"{value:.0f}" if abs(value) >= 9.95 else f"{value:.1f}"
