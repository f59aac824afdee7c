"""A study's report in files: what `make study` keeps, and from which the site's page is made again.

`page.json` has the texts and their order; every table and the figures of every picture are a CSV file of their own.
"""

import csv
import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from shutil import rmtree
from typing import Any

from studies.page import (
    Claim,
    Drawing,
    Origin,
    PageSection,
    Picture,
    Report,
    Table,
    TableRow,
    page_html,
    summary_markdown,
)

_PAPER = {False: "here", True: "paper"}
"""First column of a table: whose figures a line has."""
_SUMMARY = "summary.csv"


def write_report(folder: Path, title: str, report: Report, origin: Origin) -> None:
    """Make report.html, summary.md, figures.csv and the folder page in `folder`."""
    (folder / "report.html").write_text(page_html(title, report, origin), encoding="utf-8")
    (folder / "summary.md").write_text(summary_markdown(report, origin), encoding="utf-8")
    _write_csv(folder / "figures.csv", report.figures)
    publish(folder / "page", report, origin)


def publish(folder: Path, report: Report, origin: Origin) -> None:
    """Write what the page shows; whatever was in `folder` goes."""
    rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    number = 0
    sections = []
    for section in report.sections:
        blocks: list[str | dict[str, str]] = []
        for block in section.blocks:
            if isinstance(block, str):
                blocks.append(block)
                continue
            number += 1
            if isinstance(block, Table):
                name = f"{number:02}-table.csv"
                _write_table(folder / name, block)
                blocks.append({"table": name})
            else:
                name = f"{number:02}-{block.draw.__name__}.csv"
                _write_csv(folder / name, block.rows)
                blocks.append({"picture": name, "drawing": block.draw.__name__, "caption": block.caption})
        sections.append({"title": section.title, "blocks": blocks})
    _write_table(folder / _SUMMARY, report.summary)
    content = {
        "origin": asdict(origin),
        "asked": [" ".join(paragraph.split()) for paragraph in report.asked.split("\n\n")],
        "claims": [asdict(claim) for claim in report.claims],
        "sections": sections,
    }
    (folder / "page.json").write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def published(folder: Path, drawings: Iterable[Drawing]) -> tuple[Report, Origin]:
    """What `publish` wrote, without the figures of every run.

    ValueError: a picture has a drawing that is not among `drawings`.
    """
    by_name = {drawing.__name__: drawing for drawing in drawings}
    content = json.loads((folder / "page.json").read_text(encoding="utf-8"))

    def block(kept: str | dict[str, Any]) -> str | Table | Picture:
        if isinstance(kept, str):
            return kept
        if "table" in kept:
            return _read_table(folder / kept["table"])
        if kept["drawing"] not in by_name:
            raise ValueError(f"{folder / 'page.json'}: drawing {kept['drawing']!r}: expected of {', '.join(by_name)}")
        return Picture(by_name[kept["drawing"]], _read_csv(folder / kept["picture"]), kept["caption"])

    report = Report(
        asked="\n\n".join(content["asked"]),
        summary=_read_table(folder / _SUMMARY),
        claims=tuple(Claim(**claim) for claim in content["claims"]),
        sections=tuple(PageSection(s["title"], tuple(map(block, s["blocks"]))) for s in content["sections"]),
    )
    return report, Origin(**{f.name: content["origin"][f.name] for f in fields(Origin)})


def renew(results: Path, name: str, text: str) -> bool:
    """Put `text` between the study's marks in a Markdown file; False: there are none."""
    head, begin, rest = results.read_text(encoding="utf-8").partition(f"<!-- study {name} -->\n")
    _, end, tail = rest.partition("<!-- end -->")
    if not (begin and end):
        return False
    results.write_text(head + begin + text + end + tail, encoding="utf-8")
    return True


def _write_table(file: Path, table: Table) -> None:
    _write_csv(file, [("whose", *table.head), *((_PAPER[row.paper], *row.cells) for row in table.rows)])


def _read_table(file: Path) -> Table:
    head, *rows = _read_csv(file)
    return Table(tuple(head[1:]), tuple(TableRow(tuple(cells), whose == _PAPER[True]) for whose, *cells in rows))


def _write_csv(file: Path, rows: Sequence[Sequence[object]]) -> None:
    with file.open("w", newline="", encoding="utf-8") as opened:
        csv.writer(opened, lineterminator="\n").writerows(rows)


def _read_csv(file: Path) -> list[list[str]]:
    with file.open(newline="", encoding="utf-8") as opened:
        return list(csv.reader(opened))
