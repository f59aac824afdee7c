"""A scan on a terminal: progress, a table of what was found, and the configuration of it in a file."""

import asyncio
from collections.abc import Awaitable, Callable, Iterator
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path

import click
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from drivers.bus_settings import Parity
from drivers.can.survey import Stopped
from drivers.recognition import describe
from gateway.commissioning.scan.found import ScanProgress, ScanReport
from gateway.commissioning.scan.fragment import check_addable, merged
from gateway.commissioning.scan.unknown import next_command
from gateway.config.problems import ConfigError, Problem
from gateway.config.reading import read_text
from gateway.model.codes import NoticeCode
from gateway.model.text import Text
from gateway.runtime.signals import stop_on_signals
from gateway.runtime.terminal import duration_text, terminal
from gateway.runtime.whole_file import write_whole

ScanRun = Callable[[ScanProgress, Stopped, bool], Awaitable[ScanReport]]
"""A scan; the argument says whether a report's question was answered with yes."""

BAUDS = (9600, 19200, 38400, 57600, 115200)
ME_BAUDS = (230_400, 256_000)
PARITIES: tuple[Parity, ...] = ("N",)
BITRATES = (125_000, 250_000, 500_000, 1_000_000)
SERIAL_TIMEOUT_S = 0.15
TCP_TIMEOUT_S = 1.0
CAN_TIMEOUT_S = 0.3
LISTEN_S = 3.0


@dataclass(frozen=True, slots=True)
class ScanEnding:
    """When a scan ends, and what becomes of what it found."""

    limit: float
    """s"""
    toml: Path | None
    """File for a configuration; `-`: standard output."""
    yes: bool
    """Answer every question with yes."""


def scan_to_file(intro: str, total: int, longest_s: float, ending: ScanEnding, run: ScanRun) -> bool:
    """Check the file, print the longest duration, scan with a progress bar, print the table, write the file.

    Returns whether anything was found.
    """
    toml, limit_s, yes = ending.toml, ending.limit, ending.yes
    _existing(toml)
    said = terminal(stderr=True)
    said.print(
        f"{intro}; at most {duration_text(max(1.0, longest_s))} if nothing answers", soft_wrap=True, highlight=False
    )
    if longest_s > limit_s:
        said.print(
            f"it will be stopped after {duration_text(max(1.0, limit_s))}; name fewer speeds or units, or raise --limit"
        )
    report, ended = find(said, total, limit_s, run, yes)
    console = terminal(stderr=str(toml) == "-")  # only the configuration goes to a pipe
    print_report(console, report, ended)
    if toml is not None:
        if any(device.what.profile for device in report.found):
            _write(toml, report, yes)
        else:
            click.echo(f"nothing was recognised; {toml} was not written", err=True)
    for step in _next_steps(report, written=toml is not None):
        said.print(f"next: {step}", soft_wrap=True, highlight=False)
    return bool(report.found)


def _next_steps(report: ScanReport, *, written: bool) -> Iterator[str]:
    """What to type now."""
    if not written and any(device.what.profile for device in report.found):
        yield "the same command with --toml gateway.toml"
    for place in report.places:
        for device in place.devices:
            if not device.what.profile and (command := next_command(place, device)):
                yield command


def find(said: Console, total: int, limit_s: float, run: ScanRun, yes: bool) -> tuple[ScanReport, str]:
    """The report of a scan, after its question if it has one; and the reason if it ended early."""
    report, ended = asyncio.run(_run(said, total, limit_s, lambda p, s: run(p, s, yes)))
    if report.question and _agreed(report.question):
        report, ended = asyncio.run(_run(said, total, limit_s, lambda p, s: run(p, s, True)))
    return report, ended


def _existing(toml: Path | None) -> None:
    """Check before a long scan that its result can be added to the file. Raises ConfigError."""
    if toml is None or str(toml) == "-" or not toml.exists():
        return
    try:
        check_addable(read_text(toml), toml)
    except ConfigError as error:
        advice = Problem("", Text(NoticeCode.NOT_SCANNED))
        raise ConfigError(toml, [*error.problems, advice]) from None


async def _run(
    said: Console, total: int, limit_s: float, run: Callable[[ScanProgress, Stopped], Awaitable[ScanReport]]
) -> tuple[ScanReport, str]:
    """The report, and the reason if the scan ended early."""
    stop = asyncio.Event()
    stop_on_signals(stop)
    loop = asyncio.get_running_loop()
    deadline = loop.time() + limit_s
    columns = (
        BarColumn(20),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
        TextColumn("{task.description}", markup=False),
    )
    with Progress(*columns, console=said, transient=True) if said.is_terminal else nullcontext() as bar:
        task = None if bar is None else bar.add_task("", total=total)

        def tell(done: int, text: str) -> None:
            if bar is not None and task is not None:
                bar.update(task, completed=done, description=text)

        report = await run(tell, lambda: stop.is_set() or loop.time() > deadline)
    if stop.is_set():
        return report, "interrupted"
    return report, f"stopped after {duration_text(max(1.0, limit_s))}" if loop.time() > deadline else ""


def print_report(console: Console, report: ScanReport, ended: str) -> None:
    """A table of each place, remarks, and the counts."""
    for place in report.places:
        table = Table(
            "unit", "profile", "inputs", "evidence, and what they read", title=place.title, title_justify="left"
        )
        for device in place.devices:
            what = device.what
            text = "\n".join(
                [what.evidence, *([device.reads] if device.reads else []), *(f"check {d}" for d in what.doubts)]
            )
            table.add_row(str(device.unit), what.profile or "unknown", describe(what.inputs), text)
        console.print(table)
    for remark in report.remarks:
        console.print(f"- {remark}", highlight=False, soft_wrap=True)
    known = sum(bool(device.what.profile) for device in report.found)
    console.print(f"{len(report.found)} answered, {known} recognised")
    if ended:
        console.print(f"{ended}: {report.asked} of {report.total} asked", style="yellow")


def _write(path: Path, report: ScanReport, yes: bool) -> None:
    if str(path) == "-":
        click.echo(merged("", report.places, Path("found.toml")), nl=False)
        return
    existing = read_text(path) if path.exists() else ""
    text = merged(existing, report.places, path)
    if text == existing:
        click.echo(f"{path} already contains everything", err=True)
        return
    if existing and not yes and not _agreed(f"{path} exists. Add what is missing?"):
        click.echo(f"{path} stays as it is. A configuration of what was found:\n", err=True)
        click.echo(merged("", report.places, Path("found.toml")), nl=False)
        return
    write_whole(path, text)
    click.echo(
        f"{path} {'extended' if existing else 'written'}: name the channels, then talc-gateway probe {path}", err=True
    )


def _agreed(question: str) -> bool:
    """Whether the answer is yes. Ctrl-C, and an input that has ended, are no: what was found must not be lost."""
    try:
        return click.confirm(question, err=True)
    except click.Abort:
        click.echo(err=True)
        return False
