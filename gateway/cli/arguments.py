"""Parses arguments of the commands: CONFIG, numbers, NAME=VALUE, units, time zones, shifts, and the files to write."""

import math
import os
from collections.abc import Callable, Sequence
from functools import partial, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, get_args
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

import click
from click.core import Context, Parameter

if TYPE_CHECKING:
    from pydantic import BaseModel

    from gateway.config.model import GatewayConfig
    from gateway.telemetry.session import Access

AnyFile = click.Path(dir_okay=False, path_type=Path)
OldFile = click.Path(exists=True, dir_okay=False, path_type=Path)
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
_ACCESS = (
    click.option("--authority", type=OldFile, help="Certificates of the plant's authority, for tls/… endpoints."),
    click.option("--certificate", type=OldFile, help="Your own certificate, if the gateway asks for one; needs --key."),
    click.option("--key", type=OldFile, help="Its private key."),
    click.option("--user", help="User name, if the gateway asks for one; needs --password-file."),
    click.option("--password-file", type=OldFile, help="File that contains only the user's password."),
)

Parsed = TypeVar("Parsed")
_ACCESS_NAMES = ("authority", "certificate", "key", "user", "password_file")


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
    return Written("numbers", partial(_numbers, low, high))


def _numbers(low: int, high: int, text: str) -> tuple[int, ...]:
    found: set[int] = set()
    for part in text.split(","):
        first, _, last = part.strip().partition("-")
        if not first.isdecimal() or not (last or first).isdecimal():
            raise ValueError(f"{text!r}: expected numbers such as 1-8,12")
        if int(last or first) < int(first):
            raise ValueError(f"{text!r}: expected the smaller number first, {last}-{first}")
        found |= set(range(int(first), int(last or first) + 1))
    if min(found) < low or max(found) > high:
        raise ValueError(f"{text!r}: expected {low} to {high}")
    return tuple(sorted(found))


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
    """An option with the type and the default of a field of these settings."""
    default = settings.model_fields[field].default
    return click.option(name, type=field_type(settings, field), default=default, show_default=True, help=what)


def read_config(path: Path) -> "GatewayConfig":
    """The checked configuration; its warnings go to standard error."""
    from gateway.config.file import load
    from gateway.config.rules import cautions

    config = load(path)
    for caution in cautions(config):
        click.echo(f"warning: {path}: {caution}", err=True)
    return config


def heard_options(command: Decorated) -> Decorated:
    """Add what says whose telemetry a command shows: CONFIG, or endpoints and a prefix."""
    from gateway.config.fields import DEFAULT_PREFIX

    options = (
        click.argument("config", type=AnyFile, required=False),
        click.option(
            "--connect",
            multiple=True,
            metavar="ENDPOINT",
            help="Zenoh endpoint of a gateway or a router, such as tcp/192.168.1.5:7447; several for a site.",
        ),
        click.option(
            "--prefix",
            type=KeyPrefixText(),
            help=f"First part in the keys. Default: as in CONFIG, otherwise {DEFAULT_PREFIX}.",
        ),
    )
    return _with(options, command)


def access_options(command: Decorated) -> Decorated:
    """Add the options by which a reader proves who it is, and whom it believes."""
    return _with(_ACCESS, command)


def with_access(command: Callable[..., object]) -> Callable[..., object]:
    """The same, of which the command gets one `access`."""

    @wraps(command)
    def called(*arguments: Any, **given: Any) -> object:
        return command(*arguments, access=_access_of(*(given.pop(name) for name in _ACCESS_NAMES)), **given)

    return access_options(called)


def _with(options: Sequence[Callable[[Decorated], Decorated]], command: Decorated) -> Decorated:
    """Decorated from the last to the first, so that the help shows them in this order."""
    for option in reversed(options):
        command = option(command)
    return command


def _access_of(
    authority: Path | None, certificate: Path | None, key: Path | None, user: str | None, password_file: Path | None
) -> "Access":
    """What these options say. Raises UsageError when one is missing."""
    from drivers.section import both_or_neither
    from gateway.telemetry.session import Access

    try:
        both_or_neither("--certificate", certificate, "--key", key)
        both_or_neither("--user", user, "--password-file", password_file)
    except ValueError as error:
        raise click.UsageError(str(error)) from None
    password = None if password_file is None else password_file.read_text(encoding="utf-8").strip()
    return Access(authority=authority, certificate=certificate, key=key, user=user, password=password)


def parsed(option: str, parse: Callable[..., Parsed], *given: object) -> Parsed:
    """What an option's text means. Raises BadParameter with the text of `parse`'s ValueError."""
    try:
        return parse(*given)
    except ValueError as error:
        raise click.BadParameter(str(error), param_hint=option) from None


def _time_zone(name: str) -> ZoneInfo:
    try:
        return ZoneInfo(name)
    except (ZoneInfoNotFoundError, ValueError, OSError):
        raise ValueError(f"{name!r}: unknown time zone on this computer; expected a name like Europe/Zurich") from None


ZoneName = Written("zone", _time_zone)


def page_path(wanted: Path | None, source: Path, *others: Path | None) -> Path:
    """Path of the page to write; never one of the files that it is made from."""
    page = wanted or source.with_suffix(".html")
    check_output("page", "-o", page, source, *others)
    return page


def check_output(what: str, option: str, written: Path | None, *sources: Path | None) -> None:
    """Raises UsageError for a file to be written that is one of its sources, or whose folder does not exist."""
    if written is None:
        return
    if not written.parent.is_dir():
        raise click.UsageError(f"the {what} cannot be written: there is no folder {written.parent}; see {option}")
    for used in sources:
        if used is not None and written.exists() and written.samefile(used):
            raise click.UsageError(f"the {what} would overwrite {used}; give it another name with {option}")


def _address(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    bare = host[1:-1] if host.startswith("[") and host.endswith("]") else host
    if not bare or not port.isdecimal() or not 0 <= int(port) <= 65535 or (":" in bare and bare == host):
        raise ValueError(f"{text!r}: expected HOST:PORT, such as 127.0.0.1:8080")
    return bare, int(port)


Address = Written("address", _address)
"""Host and port; [::1]:8080 for IPv6."""
