"""The groups `scan` and `inspect`: devices are found, and read by hand."""

import click

from gateway.cli.exits import CommandsElsewhere

_SCAN = {name: f"gateway.cli.scan:{name}_command" for name in ("can", "ports", "serial", "tcp")}
_INSPECT = {
    name: f"gateway.cli.inspect:{name}_command" for name in ("nodes", "objects", "registers", "sweep", "topics")
}


@click.group(cls=CommandsElsewhere, elsewhere=_SCAN)
def scan() -> None:
    """Find devices on a wire: `scan ports`, then `scan serial PORT`, `scan can CHANNEL`, `scan tcp HOST`. Reads only.

    \b
    Each device that answers is compared with the supplied profiles, and its inputs are read. --toml writes a
    configuration; several scans can go into one file. Nothing else may use the wire: stop the gateway first. Ctrl-C
    ends the scan after the current request and shows what was found so far.
    """


@click.group(cls=CommandsElsewhere, elsewhere=_INSPECT)
def inspect() -> None:
    """Read registers, objects or nodes that no profile describes, and write the draft of a profile. Reads only.

    \b
    Shows every number that the bytes may be, side by side; choose the plausible ones, and repeat with --draft.
    Nothing else may use the wire: stop the gateway first.
    """
