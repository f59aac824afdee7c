"""The first lines of a report: how much better the machine is, and what that cost."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.base import Quality
from gateway.model.text import Language
from gateway.reporting.coverage import within_tolerance
from gateway.reporting.data import CycleSeen, ReportData, cycle_s, probing_s
from gateway.reporting.figures import Change, Summary, SummaryRow
from gateway.reporting.local import hours, shifts_between
from talc.frame import FloatArray
from talc.indicators import rms
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
    change: Change | None
    cycles: str
    probing: str


def verdict(data: ReportData, s: Summary) -> str:
    """Such as `Z at the tool: 40 → 3.6 µm RMS, 91 % less, 96 % productive`; of the worst axis, or the worst error."""
    worst, said = worst_row(s), Language(data.language)
    if worst is None:
        why = said("report.no_prediction") if s.rows else said(f"report_basis.{s.basis}")
        return said("report.nothing_to_judge", why=why)
    told = said(
        "report.verdict",
        what=said("report.at_tool", axis=worst.axis) if worst.axis else worst.name,
        before=_short(worst.e_rms, said), after=_short(worst.compensated_e_rms, said), unit=worst.unit,
        change=worst.change_rms.written(said),
    )  # fmt: skip
    return told if data.recorded is not None else said("report.productive", told=told, percent=_productive(data))


def tolerance_met(data: ReportData, s: Summary) -> str:
    """At how many of the judged instants all axes were within the tolerance, in words; empty: not known."""
    found = within_tolerance(data, s)
    if found is None or data.tolerance_um is None:
        return ""
    before, after = (100.0 * share for share in found)
    return Language(data.language)("report.within", tolerance=data.tolerance_um, before=before, after=after)


def losses(data: ReportData, s: Summary) -> tuple[tuple[str, str], ...]:
    """What was lost: the kind of loss, a key of `report_loss`; and how much, in words."""
    said = Language(data.language)
    found = [*_probing(data, said), *_gaps(data, said), *_stale(data, said)]
    if data.mode != "compensate" and data.recorded is None:
        key = "report.mode_judged" if s.rows else "report.mode"
        found.append(("unwritten", said(key, mode=data.mode)))
    worse = [
        said("report.worse", name=r.written(said), before=before, after=after, unit=r.unit)
        for r in (*s.tool, *s.rows)
        if r.compensated_e_rms > r.e_rms
        and not r.within_noise
        and (before := _short(r.e_rms, said)) != (after := _short(r.compensated_e_rms, said))
    ]
    if worse:
        found.append(("worse", ", ".join(worse)))
    held = {row.name: row.compensated_e_rms for row in s.held}
    beaten = [
        said("report.beaten", name=r.name, after=after, held=plain, unit=r.unit)
        for r in s.rows
        if held.get(r.name, np.inf) < r.compensated_e_rms
        and not r.within_noise
        and (plain := _short(held[r.name], said)) != (after := _short(r.compensated_e_rms, said))
    ]
    if beaten:
        found.append(("beaten", ", ".join(beaten)))
    return tuple(found)


def by_shift(data: ReportData, s: Summary) -> tuple[str, tuple[ShiftRow, ...]]:
    """What is judged, and the latest shifts; none of a recording, which says nothing of a machine's shifts."""
    worst, course, said = worst_row(s), s.course, Language(data.language)
    if worst is None or data.recorded is not None:
        return "", ()
    if course is not None and worst.axis:
        axis = "XYZ".index(worst.axis)
        times, before, after = course.time_s, course.before[:, axis], course.after[:, axis]
        what = said("report.at_tool", axis=worst.axis)
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


def not_good(data: ReportData, said: Language) -> list[tuple[str, str]]:
    """Channels that were not always good, and their readings by quality."""
    found = []
    for name, counts in data.channel_health.items():
        if set(counts) != {Quality.GOOD}:
            each = ", ".join(f"{said.word('quality', quality)}: {count}" for quality, count in sorted(counts.items()))
            found.append((name, each or said("report.never_read")))
    return found


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
    nothing, said = not np.isfinite(without), Language(data.language)
    return ShiftRow(
        when=data.moment(begin_s),
        before=said("report.not_measured") if nothing else _short(without, said),
        after="" if nothing else _short(left, said),
        change=None if nothing else known.change_rms,
        cycles=said("report.cycles_refused", n=_many(seen), refused=refused) if refused else str(_many(seen)),
        probing=hours(probing_s(seen, cycle_s(data.cycles_seen)), said),
    )


def worst_row(s: Summary) -> SummaryRow | None:
    """The largest without compensation: at the tool, else of the positions, else of the orientations."""
    positions = [row for row in s.rows if row.unit == ERROR_UNITS[THERMAL_ERRORS[0]]]
    for rows in (s.tool, positions, s.rows):
        known = [row for row in rows if np.isfinite(row.e_rms) and np.isfinite(row.compensated_e_rms)]
        if known:
            return max(known, key=lambda row: row.e_rms)
    return None


def _productive(data: ReportData) -> float:
    """Share of the time in which no cycle ran, %; refused cycles and the reference's take time as well."""
    lasted_s = float(data.time_s[-1]) + data.step_s
    share = 100.0 * (1.0 - probing_s(data.cycles_seen, cycle_s(data.cycles_seen)) / lasted_s)
    return max(share, 0.0)  # a reference may take longer than the first steps


def _many(requests: Sequence[CycleSeen]) -> int:
    return sum(request.cycles for request in requests)


def _probing(data: ReportData, said: Language) -> list[tuple[str, str]]:
    if not data.cycles_seen:
        return []
    many, share = _many(data.cycles_seen), 100.0 - _productive(data)
    took_s = probing_s(data.cycles_seen, cycle_s(data.cycles_seen))
    told = said("report.probing", n=many, one_s=took_s / many, lasted=hours(took_s, said), percent=share)
    found = [("probing", told)]
    refused = [cycle.refused for cycle in data.cycles_seen if cycle.refused]
    if refused:
        found.append(("refused", said("report.refused", n=len(refused), last=said.of(refused[-1]))))
    return found


def _gaps(data: ReportData, said: Language) -> list[tuple[str, str]]:
    missing = np.diff(data.k) - 1
    if data.recorded is not None or not missing.any():
        return []
    longest = int(np.argmax(missing))
    told = said(
        "report.gaps",
        n=int((missing > 0).sum()), lasted=hours(float(missing.sum()) * data.step_s, said),
        longest=hours(missing[longest] * data.step_s, said), since=data.moment(float(data.time_s[longest])),
    )  # fmt: skip
    return [("gaps", told)]


def _stale(data: ReportData, said: Language) -> list[tuple[str, str]]:
    if data.stale is None or not data.stale.any():
        return []
    lasts = np.minimum(np.diff(data.compensation_s, append=data.compensation_s[-1]), _STEP_AT_MOST_S)
    begins = int(np.flatnonzero(np.diff(data.stale.astype(int), prepend=0) == 1).size)
    return [("stale", said("report.stale", lasted=hours(float(lasts[data.stale].sum()), said), n=begins))]


def _short(value: float, said: Language) -> str:
    """`40` or `3.6`."""
    return said.number(value, ".0f" if abs(value) >= 9.95 else ".1f")
