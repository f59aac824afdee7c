"""The command `name`."""

import sys
from pathlib import Path

import click

from gateway.cli.arguments import ConfigPath, LanguageOption, OldFile, read_config
from gateway.cli.exits import EXIT_WORLD


@click.command()
@ConfigPath
@click.option("--list", "wiring", type=OldFile, help="Wiring list (CSV): name, and device and input if it says where.")
@click.option("--checklist", is_flag=True, help="Print the inputs as such a list, to fill in, and end.")
@click.option("--by", default="", metavar="PERSON", help="Who names, for the protocol. Default: this user.")
@click.option("--again", is_flag=True, help="Ask also for those that an earlier session has named.")
@LanguageOption
def name(config: Path, wiring: Path | None, checklist: bool, by: str, again: bool, language: str) -> None:
    """Name the channels of CONFIG: warm one sensor by hand, the channel that moves is shown, type its name; next.

    \b
    Each name is written at once, comments stay. With --list a sensor that moves where the list has it needs no typing.
    CONFIG with .names.csv instead of .toml says who named what when, and how far it rose; the next session goes on
    from it. Nothing is written to any device. Exit code 3: channels are left without a name.
    """
    from gateway.commissioning.naming.names import checklist as printed
    from gateway.commissioning.naming.names import read_list

    checked = read_config(config)
    if checklist:
        click.echo(printed(checked), nl=False)
        return
    listed = [] if wiring is None else read_list(wiring, checked)
    from gateway.commissioning.naming.command import name_channels

    sys.exit(0 if name_channels(config, checked, listed, by, language, again=again) else EXIT_WORLD)
