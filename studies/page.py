"""A study's report as values, and the HTML page and the Markdown table made from it."""

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
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


Rows = Sequence[Sequence[str]]
"""Lines of a CSV file, a heading first."""
Drawing = Callable[[Rows], Figure]
"""Draws a picture from its figures."""


@dataclass(frozen=True, slots=True)
class Picture:
    """Figures, how to draw them, and a caption."""

    draw: Drawing
    """One of the study's drawings."""
    rows: Rows
    caption: str

    def svg(self) -> str:
        """Inline SVG, the same for the same figures."""
        buffer = io.StringIO()
        with mpl.rc_context(_STYLE):
            FigureCanvasSVG(self.draw(self.rows)).print_svg(  # type: ignore[no-untyped-call]
                buffer, metadata={"Date": None}
            )
        text = buffer.getvalue()
        return text[text.index("<svg") :]


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
    """What it says, and where; empty: it does not ask this."""
    here: str
    holds: bool
    why: str


@dataclass(frozen=True, slots=True)
class Report:
    """One study's answer."""

    asked: str
    """What was asked, and how it was done; paragraphs divided by an empty line."""
    summary: Table
    """The figures that also appear in docs/figures.md."""
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


def figure(width: float, height: float) -> Figure:
    """An empty figure, size in inches."""
    return Figure(figsize=(width, height), layout="constrained")


def rounded_text(value: float, digits: int = 3) -> str:
    """Significant digits; large ones plain; a dash for NaN."""
    if value != value:
        return "–"
    return f"{value:.0f}" if 10**digits <= abs(value) < 1e6 else f"{value:.{digits}g}"


def columns(rows: Rows) -> dict[str, list[str]]:
    """The cells below each heading."""
    return dict(zip(rows[0], map(list, zip(*rows[1:], strict=True)), strict=True))


def page_html(title: str, report: Report, origin: Origin) -> str:
    """One page that loads nothing else."""
    template = files("studies").joinpath("page.html").read_text(encoding="utf-8")
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True)
    environment.filters["svg"] = lambda picture: Markup(picture.svg())
    environment.tests["table"] = lambda block: isinstance(block, Table)
    environment.tests["picture"] = lambda block: isinstance(block, Picture)
    return environment.from_string(template).render(title=title, report=report, origin=origin)


def summary_markdown(report: Report, origin: Origin) -> str:
    """The block of docs/figures.md."""
    made = f"`{origin.again}`, {origin.runs} runs, {origin.took}, code {origin.code}"
    return f"{report.summary.markdown()}\n{fill(made, _PROSE_WIDTH, break_long_words=False, break_on_hyphens=False)}\n"
