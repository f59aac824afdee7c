"""`talc-gateway nc`: writes the files for the control, and has its probing cycle run dry."""

import socket
from pathlib import Path

import click

from drivers.nc import LARGEST_HEIGHT_MM, LEAST_HEIGHT_MM
from gateway.cli.arguments import AnyFile, ConfigPath, FiniteNumber, LanguageOption, read_config
from gateway.config.fields import MOST_POSES


@click.group()
def nc() -> None:
    """Prepare the control: the files that go onto it, the certificate, and the dry run of its probing cycle."""


@nc.command("dry-run")
@ConfigPath
@click.option("--height-mm", type=FiniteNumber(LEAST_HEIGHT_MM, LARGEST_HEIGHT_MM), default=50.0, show_default=True,
              help="How far the cycle's path is raised.")  # fmt: skip
@click.option("-o", "--output", type=AnyFile, help="The report. Default: beside the database, .dry-run.txt.")
def dry_run(config: Path, height_mm: float, output: Path | None) -> None:
    """Have the control of CONFIG go its probing cycle's path above the sphere, without touching. THE MACHINE MOVES.

    \b
    Do this before [probing] armed = true: an armed gateway requests no cycle before a dry run has gone well with its
    control, poses and sphere. Stop the gateway first. Prints the path at each pose and records it in the database.
    Exit code 3: it did not come to its end, or went elsewhere than [probing] says.
    """
    from gateway.commissioning.dry_run import run

    run(read_config(config), height_mm, output)


@nc.command("poses")
@ConfigPath
@click.option("--sphere-mm", "spheres_mm", type=FiniteNumber(-1e4, 1e4), nargs=3, multiple=True, metavar="X Y Z",
              help="A sphere on the table, rotary axes at 0; may be repeated. Default: [probing].")  # fmt: skip
@click.option("--ring-mm", type=FiniteNumber(10.0, 1000.0),
              help="Diameter of a ring gauge in the middle of the work space.")  # fmt: skip
@click.option("--most-s", type=FiniteNumber(30.0, 3600.0), default=180.0, show_default=True,
              help="Longest cycle, by assumed speeds.")  # fmt: skip
@click.option("--most-poses", type=click.IntRange(1, MOST_POSES),
              help="Poses at most. Default: as many as poses_deg has; of a chain that is not probed, any.")  # fmt: skip
@LanguageOption
def poses(
    config: Path,
    spheres_mm: tuple[tuple[float, float, float], ...],
    ring_mm: float | None,
    most_s: float,
    most_poses: int | None,
    language: str,
) -> None:
    """Say which errors of [machine] chain can be known, how well, and at which poses best. It touches no control.

    \b
    Errors have their names of ISO 230-1 and ISO 230-7. docs/control.md explains the report. Poses are within the travel
    of [machine]. Whether they are free of spindle, clamps and walls, the dry run shows.
    """
    from gateway.commissioning.poses import lines
    from gateway.model.text import Language

    for line in lines(read_config(config), spheres_mm, ring_mm, most_s, most_poses, Language(language)):
        click.echo(line)


@nc.command("sinumerik-files")
@ConfigPath
@click.option("-o", "--output", type=click.Path(file_okay=False, exists=True, path_type=Path), default=Path(),
              help="Folder for TALC_ERRORS.SPF. Default: this one.")  # fmt: skip
def sinumerik_files(config: Path, output: Path) -> None:
    """Write the NC program of route `errors` for the machine of CONFIG. It touches no control.

    \b
    Axes, travel, origin, signs, slew and bounds are in the program, so write and load it again when one of them changes
    in CONFIG: the gateway refuses one made with others. docs/nc.md describes it, and the first hour with it.
    """
    from gateway.commissioning.sinumerik_files import write_program

    path, actions = write_program(config, output)
    click.echo(f"{path}: {actions} synchronised actions. Call it at power on instead of TALC_START")


@nc.command("certificate")
@click.option("-o", "--output", type=click.Path(file_okay=False, exists=True, path_type=Path), default=Path(),
              help="Folder. Default: this one.")  # fmt: skip
@click.option("--host", default=socket.gethostname, help="Name of the gateway's computer. Default: this one's.")
def certificate(output: Path, host: str) -> None:
    """Make the gateway's certificate for OPC UA: gateway.der, and its key gateway_key.pem. It overwrites no file.

    Copy gateway.der into the trusted certificates of the control or server; the key stays with the gateway.
    """
    from drivers.opcua.new_certificate import make_certificate

    try:
        files = make_certificate(output, host)
    except FileExistsError as error:
        raise click.UsageError(
            f"{error.filename} is there already; a control that trusts it trusts no other"
        ) from error
    for file in files:
        click.echo(file)
