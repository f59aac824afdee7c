"""Groups of commands whose modules are imported when a command of theirs is called."""

from collections.abc import Mapping
from importlib import import_module

import click


class CommandsElsewhere(click.Group):
    """Loads a command when it is called or listed, so that no command waits for the libraries of another.

    Parameters
    ----------
    elsewhere: module of each command that is not added to the group itself, in which it has that name (`-` as `_`);
        another name follows after a colon
    """

    def __init__(self, *arguments: object, elsewhere: Mapping[str, str] | None = None, **options: object) -> None:
        super().__init__(*arguments, **options)  # type: ignore[arg-type]
        self._elsewhere = dict(elsewhere or {})

    def list_commands(self, ctx: click.Context) -> list[str]:
        return sorted({*super().list_commands(ctx), *self._elsewhere})

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in self._elsewhere:
            return super().get_command(ctx, cmd_name)
        module, _, name = self._elsewhere[cmd_name].partition(":")
        found: click.Command = getattr(import_module(module), name or cmd_name.replace("-", "_"))
        return found
