"""How commands are found, their exit codes, and how their errors are reported."""

import errno
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from threading import Thread
from traceback import walk_tb
from types import CodeType

import click

from drivers.base import DriverError, SetupError
from gateway.config.problems import ConfigError
from gateway.model.codes import NoticeCode
from gateway.model.given import GivenError
from gateway.model.text import Text, language_wanted, text_of
from gateway.runtime.bounded_memory import address_space_left
from gateway.storage.faults import StoreError

EXIT_CONFIG = 2
"""The configuration or the command line is invalid."""
EXIT_WORLD = 3
"""A fault outside the program: a port in use, a device absent, an NC that refuses."""
EXIT_DIFFERENT = 1
"""A check failed: a replay that differs, a damaged database, a clause that an agent does not keep."""
_DATABASE = b"SQLite format 3\0"
_LIBRARY_BYTES = 2**25
"""Address space that the largest of the libraries takes in one piece, or a few threads."""
_GIVEN = "gateway.arguments"


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


class Commands(CommandsElsewhere):
    """Turns errors into one clear message and the right exit code."""

    def invoke(self, ctx: click.Context) -> object:
        try:
            return super().invoke(ctx)
        except (GivenError, SetupError) as error:
            click.echo(f"error: {told(error)}", err=True)
            sys.exit(EXIT_CONFIG)
        except (DriverError, StoreError, OSError) as error:
            click.echo(f"error: {told(error)}", err=True)
            sys.exit(EXIT_WORLD)
        except BaseExceptionGroup as group:
            known, other = group.split((DriverError, StoreError, OSError))
            if known is None or other is not None:
                raise
            for leaf in _leaves(known):
                click.echo(f"error: {told(leaf)}", err=True)
            sys.exit(EXIT_WORLD)
        except Exception as error:
            if _is_lack_of_memory(error):
                said = Text(NoticeCode.TOO_LITTLE_MEMORY, why=str(error) or type(error).__name__)
                click.echo(f"error: {said.in_language(language_wanted(os.environ))}", err=True)
                sys.exit(EXIT_WORLD)
            # A value that no gateway writes may raise anything, anywhere: the database says whether it is damaged.
            damaged = list(_damaged(ctx.meta.get(_GIVEN, ())))
            if not damaged:
                raise
            for text in damaged:
                click.echo(f"error: {text.in_language(language_wanted(os.environ))}", err=True)
            sys.exit(EXIT_WORLD)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        ctx.meta[_GIVEN] = tuple(args)
        return super().parse_args(ctx, args)


def _is_lack_of_memory(error: Exception) -> bool:
    """Also of a library that could not be loaded, or a thread that could not be started: these have no code."""
    if isinstance(error, OSError):
        return error.errno == errno.ENOMEM
    no_thread = isinstance(error, RuntimeError) and _raised_in(error) == Thread.start.__code__
    no_library = isinstance(error, ImportError) and address_space_left() < _LIBRARY_BYTES
    return isinstance(error, MemoryError) or no_thread or no_library


def _raised_in(error: Exception) -> CodeType | None:
    """What was left since has given back what it had."""
    frames = list(walk_tb(error.__traceback__))
    return frames[-1][0].f_code if frames else None


def _damaged(given: Sequence[str]) -> Iterator[Text]:
    """What is damaged in the databases among these arguments."""
    from gateway.storage.damage import damage_found

    for name in given:
        with suppress(OSError, ValueError):
            if Path(name).is_file() and _begins(Path(name)) == _DATABASE:
                for found in damage_found(Path(name))[:1]:
                    yield Text(NoticeCode.DATABASE_IS_DAMAGED, path=name, found=found)


def _begins(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(len(_DATABASE))


def told(error: BaseException) -> str:
    """In the terminal's language."""
    language = language_wanted(os.environ)
    return error.in_language(language) if isinstance(error, ConfigError) else text_of(error).in_language(language)


def _leaves(group: BaseExceptionGroup[BaseException]) -> list[BaseException]:
    found: list[BaseException] = []
    for error in group.exceptions:
        found += _leaves(error) if isinstance(error, BaseExceptionGroup) else [error]
    return found
