"""Exit codes of the commands, and how their errors are reported."""

import sys

import click

from drivers.base import DriverError, SetupError
from gateway.acquisition.wire_log import WireLogError
from gateway.cli.elsewhere import CommandsElsewhere
from gateway.config.problems import ConfigError
from gateway.reporting.recordings.problems import RecordingError
from gateway.storage.faults import StoreError

EXIT_CONFIG = 2
"""The configuration or the command line is invalid."""
EXIT_WORLD = 3
"""A fault outside the program: a port in use, a device absent, an NC that refuses."""
EXIT_DIFFERENT = 1
"""A comparison found a difference."""


class Commands(CommandsElsewhere):
    """Turns errors into one clear message and the right exit code."""

    def invoke(self, ctx: click.Context) -> object:
        try:
            return super().invoke(ctx)
        except (ConfigError, RecordingError, SetupError, WireLogError) as error:
            click.echo(f"error: {error}", err=True)
            sys.exit(EXIT_CONFIG)
        except (DriverError, StoreError, OSError) as error:
            click.echo(f"error: {error}", err=True)
            sys.exit(EXIT_WORLD)
        except BaseExceptionGroup as group:
            known, other = group.split((DriverError, StoreError, OSError))
            if known is None or other is not None:
                raise
            for leaf in _leaves(known):
                click.echo(f"error: {leaf}", err=True)
            sys.exit(EXIT_WORLD)


def _leaves(group: BaseExceptionGroup[BaseException]) -> list[BaseException]:
    found: list[BaseException] = []
    for error in group.exceptions:
        found += _leaves(error) if isinstance(error, BaseExceptionGroup) else [error]
    return found
