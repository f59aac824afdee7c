"""`talc-gateway report`: makes a table and an HTML page from a database and, for a simulation, from the truth."""

import hashlib
from dataclasses import replace
from pathlib import Path

from gateway.model.text import Language
from gateway.reporting.figures import summary, table
from gateway.reporting.first_lines import verdict
from gateway.reporting.page import build
from gateway.reporting.plots import picture
from gateway.runtime.terminal import terminal
from gateway.service.report_data import Reader, collect, empty_page


def write(
    database: Path,
    output: Path,
    truth: Path | None = None,
    reader: Reader | None = None,
    paper: Path | None = None,
) -> None:
    """Print the table and write the page, and of a simulation a picture too. Raises StoreError: it cannot be read.

    paper: the PDF to write; None: none
    """
    console, reader = terminal(), reader or Reader()
    said = Language(reader.language)
    empty = empty_page(database, reader)
    if empty is None:
        data = collect(database, truth, reader)
        figures = summary(data)
        console.print(verdict(data, figures), soft_wrap=True, highlight=False, markup=False)
        if figures.rows:
            console.print(table(figures, said))
        output.write_text(build(data), encoding="utf-8")
        if paper is not None:
            from gateway.reporting.paper import write_paper  # only where it is asked for

            with database.open("rb") as file:
                write_paper(paper, replace(data, source=hashlib.file_digest(file, "sha256").hexdigest()))
            console.print(said("report.written", file=str(paper)), soft_wrap=True)
        if data.truth is not None:
            output.with_suffix(".png").write_bytes(picture(data))
    else:
        output.write_text(empty, encoding="utf-8")
        console.print(said("report.no_step") if reader.day is None else said("report.no_day", day=str(reader.day)))
    console.print(said("report.written", file=str(output)), soft_wrap=True)
