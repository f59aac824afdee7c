"""A study's report as values, and the HTML page, CSV files and Markdown table made from it."""

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from textwrap import fill
from typing import Any

import matplotlib as mpl
from jinja2 import Environment, StrictUndefined
from markupsafe import Markup
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

_PROSE_WIDTH = 120
"""Characters of a line, as on all pages of docs."""
_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "talc-gateway",
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e5e7eb",
    "grid.linewidth": 0.6,
}


@dataclass(frozen=True, slots=True)
class TableRow:
    """A line of a table."""

    cells: tuple[str, ...]
    paper: bool = False
    """The paper's own figures: shown as such, never as ours."""


@dataclass(frozen=True, slots=True)
class Table:
    """A heading for each column, and lines."""

    head: tuple[str, ...]
    rows: tuple[TableRow, ...]

    def markdown(self) -> str:
        """The table as Markdown, with the paper's lines in italics."""
        lines = [f"| {' | '.join(self.head)} |", "|---|" + "---:|" * (len(self.head) - 1)]
        for row in self.rows:
            cells = [f"*{cell}*" if row.paper and cell else cell for cell in row.cells]
            lines.append(f"| {' | '.join(cells)} |")
        return "\n".join(lines) + "\n"


@dataclass(frozen=True, slots=True)
class Picture:
    """An SVG and its caption."""

    svg: str
    caption: str


@dataclass(frozen=True, slots=True)
class PageSection:
    """Paragraphs, tables and pictures under one title."""

    title: str
    blocks: tuple[str | Table | Picture, ...]


@dataclass(frozen=True, slots=True)
class Claim:
    """A finding of the paper, the finding here, and the criterion that compares them."""

    text: str
    paper: str
    here: str
    holds: bool
    why: str


@dataclass(frozen=True, slots=True)
class Report:
    """One study's answer."""

    asked: str
    """What was asked, and how it was done; paragraphs divided by an empty line."""
    summary: Table
    """The figures that also appear in docs/results.md."""
    claims: tuple[Claim, ...]
    sections: tuple[PageSection, ...]
    figures: Sequence[Sequence[object]] = field(default_factory=list)
    """Every figure of every run, a heading first: figures.csv."""


@dataclass(frozen=True, slots=True)
class Origin:
    """Origin of the figures."""

    runs: int
    seed: int
    versions: str
    code: str
    """First digits of the fingerprint of the code that made the figures; other code has others."""
    took: str
    """How long it took, on how many cores."""
    again: str
    """The command."""
    date: str


def figure(width: float, height: float) -> Figure:
    """An empty figure, size in inches. Draw it inside `style`."""
    return Figure(figsize=(width, height), layout="constrained")


def style() -> Any:
    """Context in which a picture is drawn and turned into SVG."""
    return mpl.rc_context(_STYLE)


def svg(made: Figure) -> str:
    """The figure as inline SVG, the same for the same figure."""
    buffer = io.StringIO()
    FigureCanvasSVG(made).print_svg(buffer, metadata={"Date": None})  # type: ignore[no-untyped-call]
    text = buffer.getvalue()
    return text[text.index("<svg") :]


def rounded_text(value: float, digits: int = 3) -> str:
    """Significant digits; large ones plain; a dash for NaN."""
    if value != value:
        return "–"
    return f"{value:.0f}" if 10**digits <= abs(value) < 1e6 else f"{value:.{digits}g}"


def write_page(folder: Path, title: str, report: Report, origin: Origin) -> None:
    """Make report.html, summary.md and figures.csv in `folder`."""
    template = files("studies").joinpath("page.html").read_text(encoding="utf-8")
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True)
    environment.filters["svg"] = Markup
    environment.tests["table"] = lambda block: isinstance(block, Table)
    environment.tests["picture"] = lambda block: isinstance(block, Picture)
    page = environment.from_string(template).render(title=title, report=report, origin=origin)
    (folder / "report.html").write_text(page, encoding="utf-8")
    (folder / "summary.md").write_text(summary_markdown(report, origin), encoding="utf-8")
    with (folder / "figures.csv").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows(report.figures)


def summary_markdown(report: Report, origin: Origin) -> str:
    """The block of docs/results.md."""
    made = f"`{origin.again}`, {origin.runs} runs, {origin.took}, code {origin.code}, {origin.date}"
    return f"{report.summary.markdown()}\n{fill(made, _PROSE_WIDTH, break_long_words=False, break_on_hyphens=False)}\n"


def renew(results: Path, name: str, text: str) -> bool:
    """Put `text` between the study's marks in a Markdown file; False: there are none."""
    head, begin, rest = results.read_text(encoding="utf-8").partition(f"<!-- study {name} -->\n")
    _, end, tail = rest.partition("<!-- end -->")
    if not (begin and end):
        return False
    results.write_text(head + begin + text + end + tail, encoding="utf-8")
    return True
