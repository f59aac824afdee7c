"""The commands that work on recorded data: `replay`, `prior` and `report`."""

import sys
from datetime import datetime
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

import click

from gateway.cli.arguments import (
    AnyFile,
    FiniteNumber,
    LanguageOption,
    OldFile,
    ZoneName,
    parsed,
)
from gateway.cli.exits import EXIT_DIFFERENT
from gateway.reporting.outputs import check_output, page_path
from gateway.runtime.extras import need_extra


@click.command()
@click.argument("file", type=OldFile)
@click.option("-o", "--output", type=AnyFile, help="HTML page. Default: beside FILE.")
@click.option("--config", type=OldFile, help="File with [grid] and [talc].")
@click.option("--time", default="time", show_default=True, help="Column of the time.")
@click.option("--time-of-day", metavar="COLUMN", default="",
              help="Column of the time of day, if the time column contains only the date.")  # fmt: skip
@click.option("--time-unit", metavar="UNIT", default="",
              help="Unit of times that are plain numbers: ns, us, ms, s, min, h or days.")  # fmt: skip
@click.option("--time-format", metavar="FORMAT", default="",
              help="How times are written, such as '%d.%m.%Y %H:%M', or `excel` for its numbers.")  # fmt: skip
@click.option(
    "--time-zone", type=ZoneName, metavar="ZONE", help="Time zone of times without one, such as Europe/Zurich."
)
@click.option("--runs", metavar="COLUMN", default="",
              help="Column that differs between runs, if the time of each starts again.")  # fmt: skip
@click.option("--zero-each-run", is_flag=True,
              help="Errors of each run count from its own first value (needs --runs).")  # fmt: skip
@click.option("--error", "errors", multiple=True, metavar="NAME=COLUMN",
              help="Column of a thermal error; NAME may be any name.")  # fmt: skip
@click.option("--unit", "units", multiple=True, metavar="NAME=UNIT", help="Unit of an error's column, such as mm.")
@click.option(
    "--input",
    "inputs",
    multiple=True,
    metavar="COLUMN",
    help="Column to use as an input although it resembles an error.",
)
@click.option("--ignore", "ignored", multiple=True, metavar="COLUMN", help="Column that is not an input.")
@click.option("--skip", multiple=True, metavar="LINES",
              help="Lines outside the table, such as 1-11,13: a logger's settings, a row of units.")  # fmt: skip
@click.option("--missing", multiple=True, metavar="CELL", help="Cell that stands for an unknown value, such as OVL.")
@click.option("--calibration-interval", "calibration_min", type=FiniteNumber(min=0, min_open=True),
              metavar="MINUTES", help="Time between the measurements of a calibration (method models).")  # fmt: skip
@click.option("--out", type=AnyFile,
              help="Write a table of each step: predictions, sigmas, contributions of inputs; and beside it "
              "NAME-models with the weights of what was learnt. CSV or Parquet.")  # fmt: skip
@click.option("--every-measurement", is_flag=True, help="Use all measurements, not only the requested ones.")
@LanguageOption
def replay(
    file: Path,
    output: Path | None,
    config: Path | None,
    calibration_min: float | None,
    out: Path | None,
    every_measurement: bool,
    zero_each_run: bool,
    language: str,
    **columns: Any,
) -> None:
    """Repeat the decisions of a database, or run the controller on a recording.

    FILE is a gateway's database: its frames go to a fresh controller, and every decision is compared.

    Or FILE is your own recording, CSV or Parquet: a column `time` (ISO 8601, or seconds), columns of thermal errors
    with gaps (EX0C, ... in µm; EA0C, EB0C, EC0C in µm/m), and every other column is an input. The controller runs on it
    as if it were live and writes the report. The options are for recordings.
    """
    from gateway.reporting.recordings.files import is_database
    from gateway.reporting.recordings.options import columns_of

    if is_database(file):
        from gateway.control.replay.run import show

        sys.exit(0 if show(file, language) else EXIT_DIFFERENT)
    need_extra("report")
    from gateway.control.replay.run import Request, run_recording

    page = page_path(output, file, config)
    if out is not None and out.suffix not in (".csv", ".parquet"):
        raise click.BadParameter(f"{str(out)!r}: expected a name that ends in .csv or .parquet", param_hint="--out")
    if zero_each_run and not columns["runs"]:
        raise click.UsageError("--zero-each-run: needs --runs COLUMN, the column that shows where each run begins")
    read = columns_of(**columns)
    request = Request(file, read, page, config, every_measurement, out, calibration_min, language, zero_each_run)
    for table in (request.out, request.models_out):
        check_output("table", "--out", table, file, config)
    run_recording(request)


class _SourceOrAddress(click.ParamType[Path | str]):
    """A file or folder that exists, or an address."""

    name = "place"
    _path = click.Path(exists=True, path_type=Path)

    def convert(self, value: Path | str, param: click.Parameter | None, ctx: click.Context | None) -> Path | str:
        if isinstance(value, str) and "://" in value:
            return value
        found = self._path.convert(value, param, ctx)
        return found if Path(found).is_dir() else OldFile.convert(found, param, ctx)


@click.group()
def prior() -> None:
    """Make a prior from what machines have learnt, for the next machine of the same kind."""


@prior.command("make")
@click.argument("given", metavar="DATABASE|FOLDER|ADDRESS...", nargs=-1, required=True, type=_SourceOrAddress())
@click.option("--kind", help="[machine] kind of the machines that count. Default: all, if they have the same.")
@click.option("-o", "--output", type=AnyFile, required=True, help="JSON file.")
@click.option("--database-password-file", type=OldFile, help="File that contains only the password of ADDRESS's user.")
def make_prior(
    given: tuple[Path | str, ...], kind: str | None, output: Path, database_password_file: Path | None
) -> None:
    """Write what machines have learnt to one file, for `[talc] prior` of another machine.

    Give one DATABASE per machine, or the FOLDER or ADDRESS (postgresql://…) of `talc-gateway collect` with all machines
    of a site. Each machine's learner is rebuilt from its frames and measurements, whatever method it used, and without
    the prior that it started with. Inputs of different machines are matched by name.
    """
    from gateway.commissioning.prior import make

    make(given, kind, output, database_password_file)


@click.command()
@click.argument("database", type=OldFile)
@click.option("-o", "--output", type=AnyFile, help="Default: beside DATABASE.")
@click.option(
    "--time-zone",
    type=ZoneName,
    metavar="TEXT",
    help="Time zone of the report, such as Europe/Zurich. Default: this computer's.",
)
@click.option(
    "--shifts", default="06:00,14:00,22:00", show_default=True, help="When shifts begin, local time; empty: no shifts."
)
@click.option("--day", type=click.DateTime(["%Y-%m-%d"]), help="Only this day, local time, such as 2026-03-02.")
@click.option("--pdf", is_flag=True, help="Also a PDF of at most six pages, beside the page.")
@click.option("--tolerance", type=FiniteNumber(min=0.0, min_open=True), help="Of the jobs, ± µm at the tool.")
@LanguageOption
def report(
    database: Path,
    output: Path | None,
    time_zone: ZoneInfo | None,
    shifts: str,
    day: datetime | None,
    pdf: bool,
    tolerance: float | None,
    language: str,
) -> None:
    """Write the HTML report of DATABASE and print its table."""
    need_extra("report")
    from gateway.reporting.local import shift_starts
    from gateway.service.report_data import Reader
    from gateway.service.report_file import write

    of_day = None if day is None else day.date()
    reader = Reader(time_zone, parsed("--shifts", shift_starts, shifts), of_day, language, tolerance)
    page = page_path(output, database)
    paper = page.with_suffix(".pdf") if pdf else None
    check_output("PDF", "-o", paper, database, page)
    write(database, page, reader=reader, paper=paper)
