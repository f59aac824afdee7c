"""Parses arguments of the commands: CONFIG, numbers, NAME=VALUE, units, time zones, shifts, and the files to write."""

import math
import os
from collections.abc import Callable, Sequence
from functools import partial, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, get_args

import click
from click.core import Context, Parameter

from gateway.runtime.written import host_and_port, time_zone, whole_numbers

if TYPE_CHECKING:
    from pydantic import BaseModel

    from gateway.config.model import GatewayConfig
    from gateway.telemetry.session import Access

AnyFile = click.Path(dir_okay=False, path_type=Path)


class _RegularFile(click.Path):
    """A file that exists: of a pipe nobody knows whether anything comes."""

    def convert(self, value: Any, param: Parameter | None, ctx: Context | None) -> Any:
        """Raises BadParameter."""
        from gateway.model.text import Text, language_wanted

        found = super().convert(value, param, ctx)
        if not Path(os.fsdecode(found)).is_file():
            why = Text("file_no_file").in_language(language_wanted(os.environ))
            self.fail(f"{str(found)!r}: {why}", param, ctx)
        return found


OldFile = _RegularFile(exists=True, dir_okay=False, path_type=Path)
ConfigPath = click.argument("config", type=AnyFile)


def _language(_: Context, __: Parameter, code: str | None) -> str:
    """Raises BadParameter for a language that the catalogue does not have."""
    from gateway.model.text import language_wanted, languages

    if code is not None and code not in languages():
        raise click.BadParameter(f"{code!r}: expected one of {', '.join(languages())}", param_hint="--language")
    return code or language_wanted(os.environ)


LanguageOption = click.option(
    "--language", callback=_language, metavar="CODE", help="Language, such as en or de. Default: as LANG says."
)
SCAN_LIMIT_S = 600.0
"""How long a scan takes at most, unless the user says otherwise."""
Decorated = TypeVar("Decorated", bound=Callable[..., object])
Decorator = Callable[[Callable[..., object]], Callable[..., object]]
_ACCESS = (
    click.option("--authority", type=OldFile, help="Certificates of the plant's authority, for tls/… endpoints."),
    click.option("--certificate", type=OldFile, help="Your own certificate, if the gateway asks for one; needs --key."),
    click.option("--key", type=OldFile, help="Its private key."),
    click.option("--user", help="User name, if the gateway asks for one; needs --password-file."),
    click.option("--password-file", type=OldFile, help="File that contains only the user's password."),
)

Parsed = TypeVar("Parsed")


class FiniteNumber(click.FloatRange):
    """A number, between limits if it has any. click's own also takes nan and inf, which no comparison refuses."""

    def convert(self, value: float, param: Parameter | None, ctx: Context | None) -> float:
        """Raises BadParameter."""
        found = float(super().convert(value, param, ctx))
        if not math.isfinite(found):
            self.fail(f"{value!r}: expected a finite number", param, ctx)
        return found


class Written(click.ParamType[Parsed]):
    """What a text means. Refused with the words of its parser's ValueError."""

    def __init__(self, name: str, parse: Callable[[str], Parsed]) -> None:
        self.name, self._parse = name, parse

    def convert(self, value: "str | Parsed", param: Parameter | None, ctx: Context | None) -> Parsed:
        try:
            return self._parse(value) if isinstance(value, str) else value
        except ValueError as error:
            self.fail(str(error), param, ctx)


class KeyPrefixText(Written[str]):
    """What keys may begin with, as `[telemetry] prefix` has it."""

    def __init__(self) -> None:
        from gateway.config.fields import key_prefix

        super().__init__("text", key_prefix)


def numbers(low: int, high: int) -> Written[tuple[int, ...]]:
    """`1-8,12`: whole numbers within bounds, each once, in order."""
    return Written("numbers", partial(whole_numbers, low, high))


def field_type(settings: type["BaseModel"], field: str) -> "click.Choice[Any] | click.IntRange":
    """The choices of a field of these settings, or whole numbers within its bounds."""
    about = settings.model_fields[field]
    choices = get_args(about.annotation)
    low, high = (
        next((getattr(rule, bound) for rule in about.metadata if hasattr(rule, bound)), None) for bound in ("ge", "le")
    )
    return click.Choice(choices) if choices else click.IntRange(low, high)


def field_option(
    name: str, settings: type["BaseModel"], field: str, what: str | None = None
) -> Callable[[Decorated], Decorated]:
    """An option with the name, the type and the default of a field of these settings."""
    default = settings.model_fields[field].default
    return click.option(name, field, type=field_type(settings, field), default=default, show_default=True, help=what)


def answer_timeout(what: str, default_s: float) -> Callable[[Decorated], Decorated]:
    """How long an answer may take; `what` is the option's help."""
    from drivers.section import LONGEST_ANSWER_S

    return click.option("--timeout", "timeout_s", type=FiniteNumber(0.01, LONGEST_ANSWER_S), default=default_s,
                        show_default=True, help=what)  # fmt: skip


def read_config(path: Path) -> "GatewayConfig":
    """The checked configuration; its warnings go to standard error."""
    from gateway.config.file import load
    from gateway.config.rules import cautions
    from gateway.model.text import language_wanted

    config, language = load(path), language_wanted(os.environ)
    for caution in cautions(config):
        click.echo(f"warning: {path}: {caution.in_language(language)}", err=True)
    return config


def _ask_password(ctx: Context, _: Parameter, wanted: bool) -> None:
    if wanted:
        from gateway.runtime.passwords import ask_password

        ask_password()
        ctx.exit()


def _heard(config: Path | None, connect: tuple[str, ...], prefix: str | None, **where: Any) -> dict[str, Any]:
    """Raises UsageError."""
    if config is None and not connect:
        raise click.UsageError("give CONFIG, or --connect ENDPOINT")
    read = None if config is None else read_config(config)
    host, port = where.pop("listen")
    return {"config": read, "connect": connect, "prefix": prefix, "host": host, "port": port, **where}


def serving_options(listen: str, settings: str) -> Decorator:
    """What a program that shows gateways takes: which gateways, where it listens, its settings; as one `shown`.

    listen: the usual address; settings: what the file of settings holds
    """
    from gateway.config.fields import DEFAULT_PREFIX

    return gathered(
        "shown",
        _heard,
        click.argument("config", type=AnyFile, required=False),
        click.option("--connect", multiple=True, metavar="ENDPOINT", help="Zenoh endpoint of a gateway or a router, "
                     "such as tcp/192.168.1.5:7447; several for a site."),
        click.option("--prefix", type=KeyPrefixText(),
                     help=f"First part in the keys. Default: as in CONFIG, otherwise {DEFAULT_PREFIX}."),
        click.option("--settings", type=AnyFile, help=f"TOML file: {settings}."),
        click.option("--listen", type=Address, default=listen, show_default=True, metavar="HOST:PORT",
                     help="Address to serve."),
        click.option("--make-password", is_flag=True, is_eager=True, expose_value=False, callback=_ask_password,
                     help="Ask for a password, print its hash for --settings, and end."),
    )  # fmt: skip


def gathered(name: str, make: Callable[..., object], *options: Callable[[Any], Any]) -> Decorator:
    """Options of which a command gets one argument of this name: what `make` returns for them, each by its name."""

    def nothing() -> None:
        """Carries them, to ask them for their names."""

    carried = getattr(_with(options, nothing), "__click_params__")  # noqa: B009
    names = [option.name for option in carried if option.expose_value]

    def decorate(command: Callable[..., object]) -> Callable[..., object]:
        @wraps(command)
        def called(*arguments: Any, **given: Any) -> object:
            return command(*arguments, **{name: make(**{each: given.pop(each) for each in names})}, **given)

        return _with(options, called)

    return decorate


def _with(options: Sequence[Callable[[Any], Any]], command: Decorated) -> Decorated:
    """Decorated from the last to the first, so that the help shows them in this order."""
    for option in reversed(options):
        command = option(command)
    return command


def _access_of(**given: Any) -> "Access":
    from gateway.telemetry.subscriber.places import access_of

    return access_of(**given)


with_access = gathered("access", _access_of, *_ACCESS)
"""A reader's credentials, and the authority that it trusts: an Access."""
with_proof = gathered("proof", dict, *_ACCESS)
"""The same options as they are."""


def parsed(option: str, parse: Callable[..., Parsed], *given: object) -> Parsed:
    """What an option's text means. Raises BadParameter with the text of `parse`'s ValueError."""
    try:
        return parse(*given)
    except ValueError as error:
        raise click.BadParameter(str(error), param_hint=option) from None


ZoneName = Written("zone", time_zone)


Address = Written("address", host_and_port)
"""Host and port; [::1]:8080 for IPv6."""
