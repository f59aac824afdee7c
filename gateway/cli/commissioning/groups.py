"""The groups `scan` and `inspect`: devices are found, and read by hand."""

import click

from gateway.cli.conventions.elsewhere import CommandsElsewhere

_SCAN = {name: f"gateway.cli.commissioning.scan:{name}_command" for name in ("can", "ports", "serial", "tcp")}
_INSPECT = {
    "nodes": "gateway.cli.commissioning.inspection_named:nodes_command",
    "objects": "gateway.cli.commissioning.inspection_named:objects_command",
    "registers": "gateway.cli.commissioning.inspection:registers_command",
    "topics": "gateway.cli.commissioning.inspection_topics:topics_command",
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
    Every number that the bytes may be stands side by side; choose the plausible ones, and repeat with --draft.
    Nothing else may use the wire: stop the gateway first.
    """
