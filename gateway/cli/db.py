"""`talc-gateway db`: looks after a database, also while a gateway writes to it."""

import os
import sys
from contextlib import suppress
from pathlib import Path

import click

from gateway.cli.arguments import AnyFile, OldFile, read_config
from gateway.cli.exits import EXIT_DIFFERENT, told
from gateway.model.codes import NoticeCode
from gateway.model.text import Text, language_wanted

Database = click.argument("database", type=OldFile)
_MB = 1e6


@click.group()
def db() -> None:
    """Check, measure, export or back up a database, also while a gateway writes to it."""


@db.command()
@Database
def check(database: Path) -> None:
    """Read all of DATABASE and say what is damaged: pages, rows, snapshots. Exit code 1: something is damaged."""
    from gateway.storage.damage import damage_found
    from gateway.storage.faults import DamagedError
    from gateway.storage.history import History
    from gateway.storage.place import check_left

    found = list[str]()
    try:
        check_left(database)
    except DamagedError as error:
        found.append(told(error))
    with suppress(DamagedError), History(database):  # raises for what is not a database of this program
        pass
    found += damage_found(database)
    for text in found:
        click.echo(f"{database}: {text}")
    click.echo(f"{database}: {'damaged' if found else 'whole'}")
    sys.exit(EXIT_DIFFERENT if found else 0)


@db.command()
@Database
def stats(database: Path) -> None:
    """Show what DATABASE contains: rows and size of each table, and the free space in it."""
    from gateway.storage.history import History

    with History(database) as history:
        click.echo(f"{'table':<16}{'rows':>12}{'MB':>10}")
        for table, rows, size in history.sizes():
            click.echo(f"{table:<16}{'' if table == 'other' else rows:>12}{size / _MB:>10.2f}")
        first, last = history.span()
        free = history.free_bytes()
    on_disk = sum(p.stat().st_size for p in (database, database.with_name(database.name + "-wal")) if p.exists())
    click.echo(f"on the disk {on_disk / _MB:.2f} MB, of which {free / _MB:.2f} MB are free for new rows")
    click.echo("no grid step yet" if first is None or last is None else f"grid steps {first} to {last}")


@db.command()
@Database
@click.argument(
    "table",
    metavar="TABLE",
    type=click.Choice(["readings", "minutes", "steps", "measurements", "events", "compensation", "commands", "runs"]),
)
@click.option("-o", "--output", type=AnyFile, required=True, help=".csv or .parquet")
def export(database: Path, table: str, output: Path) -> None:
    """Write TABLE of DATABASE to a file, one value a column (docs/commands.md describes them).

    TABLE is readings, minutes, steps, measurements, events, compensation, commands or runs.
    """
    from gateway.storage.exported import export_table

    if output.suffix not in (".csv", ".parquet"):
        raise click.BadParameter(f"{str(output)!r}: expected a name that ends in .csv or .parquet", param_hint="-o")
    click.echo(f"{output}: {export_table(database, table, output)} rows")


@db.command()
@Database
@click.option("-o", "--output", type=AnyFile, required=True, help="Must not exist.")
@click.option(
    "--without-readings", is_flag=True, help="Leave out raw readings and their means: nothing is learnt of them."
)
def backup(database: Path, output: Path, without_readings: bool) -> None:
    """Copy DATABASE to a file, also while a gateway writes to it; the file appears once it is complete.

    A gateway that is started with the copy goes on from it, also on another computer (docs/site.md). Exit code 1: what
    was copied is damaged.
    """
    from gateway.storage.backup import back_up
    from gateway.storage.damage import damage_found

    if output.exists():
        raise click.UsageError(f"{output} already exists; give another name with -o")
    back_up(database, output, readings=not without_readings)
    click.echo(f"{output}: {output.stat().st_size / _MB:.1f} MB")
    if found := damage_found(output):
        said = Text(NoticeCode.BACKUP_IS_DAMAGED, path=str(database), found="; ".join(found))
        click.echo(said.in_language(language_wanted(os.environ)), err=True)
        sys.exit(EXIT_DIFFERENT)


@db.command("export-learnt")
@Database
@click.option("-o", "--output", type=AnyFile, required=True, help="A JSON file.")
def export_learnt(database: Path, output: Path) -> None:
    """Write what the gateway of DATABASE has learnt, for `import-learnt`: weights, models and the reference.

    The record is not in it. A prior for other machines of the kind comes from `talc-gateway prior make`.
    """
    from gateway.control.restart.learnt_file import export_learnt

    click.echo(export_learnt(database, output))


@db.command("import-learnt")
@click.argument("config", type=OldFile)
@click.argument("file", type=OldFile)
@click.option(
    "--replace", is_flag=True, help="If the database has a record, keep it under another name and begin a new one."
)
def import_learnt(config: Path, file: Path, replace: bool) -> None:
    """Begin the database of CONFIG with what `export-learnt` wrote to FILE; the next `run` continues from it.

    Inputs are matched by name. The gateway must not run meanwhile.
    """
    from gateway.control.restart.learnt_file import take

    for line in take(read_config(config), file, replace=replace):
        click.echo(line)
