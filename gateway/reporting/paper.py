"""The report on paper: a PDF of at most six pages, for a manager, a quality engineer and a process engineer."""

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure

from drivers.base import Quality
from gateway.model.text import Language, Value
from gateway.reporting.charts import ChartGroup, Ink, error_charts, input_charts, tool_charts
from gateway.reporting.coverage import Covered, covered
from gateway.reporting.data import ReportData, cycle_s, probing_s
from gateway.reporting.figures import Summary, SummaryRow, summary
from gateway.reporting.first_lines import by_shift, losses, not_good, tolerance_met, verdict, worst_row
from gateway.reporting.local import hours
from gateway.reporting.plots import CHART_STYLE, INK_COLOURS, across, draw_chart, show_time
from talc.frame import EventKind
from talc.names import ERROR_UNITS, THERMAL_ERRORS

_A4: Final = (8.27, 11.69)
_LEFT, _RIGHT, _TOP, _BOTTOM = 0.08, 0.94, 0.955, 0.05
_LINE: Final = 0.0175
"""Height of a line of text, as a share of the page's."""
_LETTERS: Final = 104
"""In a line of ordinary text."""
_SCALE, _NAME = 0.085, 0.017
"""Room left of a chart, as shares of the page's width: for its axis, and of that for the axis's name."""
_NAME_LETTERS: Final = 0.62
"""Width of a letter of an axis's name, as a share of its size."""
_MOST_NAMES: Final = 10
_SIZES: Final = (8.0, 7.0, 6.0, 5.0)
"""Of a table's letters, in points: the largest with which it fits."""
_GREY = "#5a6570"
_ZONE = "#e7f3ef"
_RULE = "#cdd4db"
_STYLE = {**CHART_STYLE, "pdf.fonttype": 42, "font.size": 8.5}


class _Sheet:
    """One page, filled from the top."""

    def __init__(self, paper: PdfPages, foot: str, number: int) -> None:
        self.figure, self._paper, self._y = Figure(figsize=_A4), paper, _TOP
        self._text(_LEFT, 0.025, foot, size=7, colour=_GREY)
        self._text(_RIGHT, 0.025, str(number), size=7, colour=_GREY, right=True)

    def _text(self, x: float, y: float, text: str, *, size: float, colour: str = "#111", bold: bool = False,
              right: bool = False) -> None:  # fmt: skip
        self.figure.text(x, y, text, fontsize=size, color=colour, fontweight="bold" if bold else "normal",
                         ha="right" if right else "left", va="top", parse_math=False)  # fmt: skip

    def heading(self, text: str, size: float = 12.0) -> None:
        letters = round(_LETTERS * 8.5 / size * 0.92)
        for line in textwrap.wrap(text, letters):
            self._text(_LEFT, self._y, line, size=size, bold=True)
            self._y -= _LINE * size / 8.5
        self._y -= 0.4 * _LINE

    def lines(self, texts: Sequence[str], *, colour: str = "#111", mark: str = "") -> None:
        """Paragraphs; mark: before each."""
        for text in texts:
            for i, line in enumerate(textwrap.wrap(text, _LETTERS - len(mark)) or [""]):
                self._text(_LEFT, self._y, f"{mark if not i else ' ' * 2 * len(mark)}{line}", size=8.5, colour=colour)
                self._y -= _LINE
        self._y -= 0.5 * _LINE

    def table(self, heads: Sequence[str], rows: Sequence[Sequence[str]], widths: Sequence[float],
              room: float = 1.0) -> None:  # fmt: skip
        """widths: shares of the page; what does not fit a cell goes on below it. room: share of the page's height"""
        across = (_RIGHT - _LEFT) / sum(widths)
        starts = [_LEFT + across * sum(widths[:i]) for i in range(len(widths))]
        for size in _SIZES:
            high, letters = 0.92 * _LINE * size / 8.0, _LETTERS * 8.0 / size / sum(widths)
            lines = [
                [
                    textwrap.wrap(cell, max(round(w * letters) - 1, 4)) or [""]
                    for cell, w in zip(row, widths, strict=True)
                ]
                for row in (heads, *rows)
            ]
            if sum(high * max(map(len, cells)) + 0.25 * high for cells in lines) <= room:
                break
        for i, cells in enumerate(lines):
            for x, cell in zip(starts, cells, strict=True):
                for j, line in enumerate(cell):
                    self._text(x, self._y - j * high, line, size=size, colour=_GREY if not i else "#111")
            self._y -= high * max(map(len, cells)) + 0.125 * high
            self.figure.add_artist(mpl.lines.Line2D([_LEFT, _RIGHT], [self._y + 0.125 * high] * 2, color=_RULE, lw=0.5))
            self._y -= 0.125 * high
        self._y -= 0.8 * _LINE

    def numbers(self, found: Sequence[tuple[str, str]]) -> None:
        """Large, beside each other, each with what it is."""
        wide = (_RIGHT - _LEFT) / max(len(found), 1)
        for i, (number, what) in enumerate(found):
            self._text(_LEFT + i * wide, self._y, number, size=17, bold=True)
            for j, line in enumerate(textwrap.wrap(what, 34)):
                self._text(_LEFT + i * wide, self._y - 1.9 * _LINE - j * _LINE * 0.9, line, size=8, colour=_GREY)
        self._y -= 5.2 * _LINE

    def axes(self, height: float, low: float = 0.0) -> Axes:
        """A chart of this share of the page's height. low: room below it"""
        self._y -= height
        wide = _RIGHT - _LEFT - _SCALE
        found = self.figure.add_axes((_LEFT + _SCALE, self._y, wide, height - 0.03))
        found.yaxis.set_label_coords((_NAME - _SCALE) / wide, 0.5)
        self._y -= low
        return found

    @property
    def left(self) -> float:
        """Share of the page that is free."""
        return self._y - _BOTTOM

    def end(self) -> None:
        self._paper.savefig(self.figure)  # type: ignore[no-untyped-call]


def write_paper(path: Path, data: ReportData) -> None:
    """Write the PDF. Raises OSError if it cannot be written."""
    said, s = Language(data.language), summary(data)
    foot = f"{data.machine} · {data.moment(0.0)} – {data.moment(float(data.time_s[-1]))} · talc-gateway"
    about = {"Title": f"{data.machine}: {verdict(data, s)}", "Creator": "talc-gateway", "CreationDate": None}
    with mpl.rc_context(_STYLE), PdfPages(path, metadata=about) as paper:
        for number, fill in enumerate((_manager, _quality, _tool, _inputs, _errors, _records), start=1):
            sheet = _Sheet(paper, foot, number)
            fill(sheet, data, s, said)
            sheet.end()


def _manager(sheet: _Sheet, data: ReportData, s: Summary, said: Language) -> None:
    """The picture, the verdict, and what to do."""

    def t(key: str, **values: Value) -> str:
        return said(f"report_paper.{key}", **values)

    sheet.heading(tolerance_met(data, s) or verdict(data, s), 13.0)
    begin, end, lasted = data.moment(0.0), data.moment(float(data.time_s[-1])), hours(s.hours * 3600.0, said)
    sheet.lines([said("report.span", machine=data.machine, begin=begin, end=end, lasted=lasted)], colour=_GREY)
    one_s = cycle_s(data.cycles_seen)
    spent = probing_s(data.cycles_seen, one_s)
    whole = float(data.time_s[-1]) + data.step_s
    shown: list[tuple[str, str]] = []
    row = worst_row(s)
    if row is not None:
        what = t("less", what=row.written(said), before=row.e_rms, after=row.compensated_e_rms, unit=row.unit)
        shown.append((row.change_rms.written(said), what))
    if data.recorded is None:
        left = max(whole - spent, 0.0)
        shown.append((hours(left, said), t("minutes", probing=hours(spent, said), percent=100.0 * left / whole)))
    sheet.numbers(shown)
    _before_and_after(sheet.axes(0.3, 0.035), data, s, said)
    sheet.heading(t("to_do"))
    sheet.lines(_to_do(data, s, said) or [t("nothing_to_do")], mark="•  ")
    sheet.heading(said("report.what_was_lost"))
    lost = [f"{said(f'report_loss.{what}')}: {told}" for what, told in losses(data, s)]
    sheet.lines(lost or [said("report.nothing_lost")], mark="•  ")


def _before_and_after(axes: Axes, data: ReportData, s: Summary, said: Language) -> None:
    """The worst direction at the tool without and with compensation, against the tolerance."""
    row, course = worst_row(s), s.course
    if row is None or course is None or not row.axis:
        axes.set_axis_off()
        return
    i = "XYZ".index(row.axis)
    if data.tolerance_um is not None:
        axes.axhspan(-data.tolerance_um, data.tolerance_um, color=_ZONE, lw=0, zorder=0,
                     label=said("report_paper.tolerance", tolerance=data.tolerance_um))  # fmt: skip
    style = "-" if course.basis == "simulated" else ".-"
    at = across(data, course.time_s)
    for values, ink, key in ((course.before, Ink.BEFORE, "without"), (course.after, Ink.ESTIMATE, "with")):
        axes.plot(at, values[:, i], style, color=INK_COLOURS[ink], lw=1.2, ms=3, label=said(f"report_line.{key}"))
    axes.set_ylabel(f"{row.written(said)}, {row.unit}")
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, fontsize=8, frameon=False)
    show_time(axes, data)


def _to_do(data: ReportData, s: Summary, said: Language) -> list[str]:
    """What somebody should do, worst first."""
    found = [" ".join(each.written(said)) for each in data.not_yet]
    suspects = [e for _, e in data.events if e.kind in (EventKind.SENSOR_SUSPECT, EventKind.SENSORS_AGREE)]
    if suspects and suspects[-1].kind is EventKind.SENSOR_SUSPECT:
        found.append(said("report_paper.suspect", text=said.of(suspects[-1].text)))
    never = [name for name, counts in data.channel_health.items() if not counts.get(Quality.GOOD)]
    if never:
        found.append(said("report_paper.silent", names=_some(never)))
    if data.mode != "compensate" and data.recorded is None:
        found.append(said("report_paper.mode", mode=data.mode))
    good = {row.name for row in s.tool if row.compensated_e_rms <= row.e_rms}
    if worse := [row.written(said) for row in s.tool if row.name not in good and not row.within_noise]:
        found.append(said("report_paper.worse", names=", ".join(worse)))
    late = [what for what, _, _, due in data.instruments if due and due < f"{_last_day(data)}"]
    if late:
        found.append(said("report_paper.overdue", names=_some(late)))
    return found


def _some(names: Sequence[str]) -> str:
    more = len(names) - _MOST_NAMES
    return ", ".join(names[:_MOST_NAMES]) + (f" + {more}" if more > 0 else "")


def _last_day(data: ReportData) -> str:
    return data.moment(float(data.time_s[-1])).split()[1] if data.origin_s is None else ""


def _quality(sheet: _Sheet, data: ReportData, _: Summary, said: Language) -> None:
    """What was measured with, how sure it is, and how often that was true."""

    def t(key: str, **values: Value) -> str:
        return said(f"report_paper.{key}", **values)

    sheet.heading(t("quality"))
    sheet.heading(t("instruments"), 9.5)
    if data.instruments:
        sheet.table([t("what"), t("serial"), t("calibrated"), t("due")], data.instruments, (6, 6, 1.7, 1.7), 0.52)
    else:
        sheet.lines([t("no_instruments")])
    if data.sphere_m is not None:
        radius, height = (1e3 * each for each in data.sphere_m)
        sheet.lines([t("sphere", radius=radius, height=height)])
    sheet.heading(t("uncertainty"), 9.5)
    sheet.lines([t("uncertainty_note")])
    rows = [_uncertain(data, each, said) for each in covered(data)]
    heads = [said("report_column.error"), said("report_column.unit"), t("noise"), t("half"), t("count"), t("inside")]
    sheet.table(heads, rows, (2, 1, 2, 2, 2, 2))


def _uncertain(data: ReportData, c: Covered, said: Language) -> tuple[str, ...]:
    noise = np.nan if data.noise is None else float(data.noise[c.error])
    share = (
        said("report_paper.of", n=c.inside, of=c.compared, percent=100.0 * c.inside / c.compared) if c.compared else "–"
    )
    return (
        data.labels[c.error],
        ERROR_UNITS[THERMAL_ERRORS[c.error]],
        *(said.number(v, ".2f") if np.isfinite(v) else "–" for v in (noise, c.half)),
        str(c.compared),
        share,
    )


def _figures(row: SummaryRow, said: Language) -> tuple[str, ...]:
    values = (row.e_rms, row.compensated_e_rms, row.e_pv, row.compensated_e_pv)
    return (row.written(said), row.unit, *(said.number(v, ".2f") for v in values), row.change_rms.written(said))


def _charts(sheet: _Sheet, data: ReportData, group: ChartGroup | None, most: int, said: Language) -> None:
    """A group's charts, each as high as they share the page."""
    charts = () if group is None else group.charts[:most]
    if not charts:
        sheet.lines([said("report_paper.no_chart")])
        return
    height = min((sheet.left - 0.02) / len(charts), 0.3)
    for chart in charts:
        axes = sheet.axes(height - 0.025, 0.025)
        draw_chart(axes, data, chart)
        name, room = axes.yaxis.label, 72.0 * _A4[1] * axes.get_position().height
        name.set_fontsize(min(8.5, room / (_NAME_LETTERS * max(len(name.get_text()), 1))))
        show_time(axes, data)


def _tool(sheet: _Sheet, data: ReportData, s: Summary, said: Language) -> None:
    """What was gained, and its course."""
    sheet.heading(said("report.without_and_with"))
    sheet.lines([said("report.basis", basis=said(f"report_basis.{s.basis}"),
                      begin=data.moment(s.begin_hours * 3600.0))], colour=_GREY)  # fmt: skip
    heads = [said("report_column.error"), said("report_column.unit"), "E_RMS", said("report_column.with"), "E_PV",
             said("report_column.with"), said("report_column.change")]  # fmt: skip
    sheet.table(heads, [_figures(row, said) for row in (*s.tool, *s.rows)], (2, 1, 1.1, 1.1, 1.1, 1.1, 4))
    sheet.heading(said("report_line.tool"), 9.5)
    if s.course is not None and data.compensation_s.size:
        place = said(f"report.tool_{s.course.basis}")
        sheet.lines([said("report_paper.offset_where", place=place)], colour=_GREY)
    _charts(sheet, data, tool_charts(data, s.course), 3, said)


def _inputs(sheet: _Sheet, data: ReportData, _: Summary, said: Language) -> None:
    group, basis = input_charts(data)
    sheet.heading(said("report_line.inputs"))
    if basis:
        sheet.lines([said("report.shown", what=basis)], colour=_GREY)
    _charts(sheet, data, group, 4, said)


def _errors(sheet: _Sheet, data: ReportData, _: Summary, said: Language) -> None:
    """The nine, small, each on its own scale."""
    sheet.heading(said("report.each_error"))
    known = [e for e in range(len(THERMAL_ERRORS)) if np.isfinite(data.corrected[:, e]).any()]
    for e in known:
        axes = sheet.axes(0.094, 0.0)
        draw_chart(axes, data, error_charts(data, e).charts[0], legend=e == known[0])
        axes.set_ylabel(f"{data.labels[e]}, {ERROR_UNITS[THERMAL_ERRORS[e]]}", fontsize=7)
        show_time(axes, data, named=e == known[-1])


def _records(sheet: _Sheet, data: ReportData, s: Summary, said: Language) -> None:
    """Shifts, channels, and from what the report was made."""
    what, shifts = by_shift(data, s)
    if shifts:
        sheet.heading(said("report.by_shift"))
        sheet.lines([said("report.latest_shifts", what=what)], colour=_GREY)
        heads = [said(f"report_column.{name}") for name in ("from", "without", "with", "change", "cycles", "probing")]
        rows = [(r.when, r.before, r.after, "" if r.change is None else r.change.written(said), r.cycles, r.probing)
                for r in shifts[-24:]]  # fmt: skip
        sheet.table(heads, rows, (4, 2, 2, 3, 3, 2))
    bad = [f"{name}: {told}" for name, told in not_good(data, said)]
    sheet.heading(said("report.channels"))
    good = len(data.channel_health) - len(bad)
    room = max(int(sheet.left / _LINE) - 14, 3)
    more = [said("report_paper.more", n=len(bad) - room)] if len(bad) > room else []
    sheet.lines([*bad[:room], *more] or [said("report.all_good", n=good)])
    sheet.heading(said("report.how_made"))
    made = [f"{said('report.configuration')} {data.fingerprint}", data.versions]
    if data.source:
        made.append(said("report_paper.source", hash=data.source))
    sheet.lines([*made, *(f"{name}: {text}" for name, text in data.made)])
