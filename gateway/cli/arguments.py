"""Parses arguments of the commands: CONFIG, numbers, NAME=VALUE, units, time zones, shifts, and the files to write."""

import math
import os
from collections.abc import Callable, Sequence
from datetime import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, get_args
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

import click
from click.core import Context, Parameter

if TYPE_CHECKING:
    from pydantic import BaseModel

    from gateway.config.model import GatewayConfig
    from gateway.telemetry.session import Access

ConfigPath = click.argument("config", type=click.Path(dir_okay=False, path_type=Path))
PemPath = click.Path(exists=True, dir_okay=False, path_type=Path)


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
    click.option("--authority", type=PemPath, help="Certificates of the plant's authority, for tls/… endpoints."),
    click.option("--certificate", type=PemPath, help="Your own certificate, if the gateway asks for one; needs --key."),
    click.option("--key", type=PemPath, help="Its private key."),
    click.option("--user", help="User name, if the gateway asks for one; needs --password-file."),
    click.option("--password-file", type=PemPath, help="File that contains only the user's password."),
)


class FiniteNumber(click.FloatRange):
    """A number, between limits if it has any. click's own also takes nan and inf, which no comparison refuses."""

    def convert(self, value: float, param: Parameter | None, ctx: Context | None) -> float:
        """Raises BadParameter."""
        found = float(super().convert(value, param, ctx))
        if not math.isfinite(found):
            self.fail(f"{value!r}: expected a finite number", param, ctx)
        return found


class Numbers(click.ParamType[tuple[int, ...]]):
    """`1-8,12`: whole numbers within bounds, each once, in order."""

    name = "numbers"

    def __init__(self, low: int, high: int) -> None:
        self._low, self._high = low, high

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, ...]:
        if isinstance(value, tuple):
            return value
        found: set[int] = set()
        for part in str(value).split(","):
            first, _, last = part.strip().partition("-")
            if not first.isdecimal() or not (last or first).isdecimal():
                self.fail(f"{value!r}: expected numbers such as 1-8,12", param, ctx)
            if int(last or first) < int(first):
                self.fail(f"{value!r}: expected the smaller number first, {last}-{first}", param, ctx)
            found |= set(range(int(first), int(last or first) + 1))
        if min(found) < self._low or max(found) > self._high:
            self.fail(f"{value!r}: expected {self._low} to {self._high}", param, ctx)
        return tuple(sorted(found))


class KeyPrefixText(click.ParamType[str]):
    """What keys may begin with, as `[telemetry] prefix` has it."""

    name = "text"

    def convert(self, value: str, param: Parameter | None, ctx: Context | None) -> str:
        """Raises BadParameter."""
        from gateway.config.fields import key_prefix

        try:
            return key_prefix(value)
        except ValueError as error:
            self.fail(str(error), param, ctx)


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
        click.argument("config", type=click.Path(dir_okay=False, path_type=Path), required=False),
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


def _with(options: Sequence[Callable[[Decorated], Decorated]], command: Decorated) -> Decorated:
    """Decorated from the last to the first, so that the help shows them in this order."""
    for option in reversed(options):
        command = option(command)
    return command


def access_of(
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


def _pairs(pairs: tuple[str, ...], option: str, expected: str) -> dict[str, str]:
    """Text of each name, from NAME=TEXT."""
    found: dict[str, str] = {}
    for pair in pairs:
        name, equals, text = pair.partition("=")
        if not (name and equals and text):
            raise click.BadParameter(f"{pair!r}: expected {expected}", param_hint=option)
        if name in found:
            raise click.BadParameter(f"{name} is given twice: {found[name]!r} and {text!r}", param_hint=option)
        found[name] = text
    return found


def named_errors(pairs: tuple[str, ...]) -> dict[str, str]:
    """Column of each error. Refuses a name that is nearly the name of a thermal error."""
    from talc.names import THERMAL_ERRORS, like_an_error

    found = _pairs(pairs, "--error", "NAME=COLUMN")
    for name in found:
        if name not in THERMAL_ERRORS and like_an_error(name):
            expected = f"expected one of {', '.join(THERMAL_ERRORS)}, or a name that does not look like one"
            raise click.BadParameter(f"{name}={found[name]}: {expected}", param_hint="--error")
    return found


def named_units(pairs: tuple[str, ...]) -> dict[str, str]:
    """Unit of each error."""
    from talc.units import COLUMN_UNITS, plain_unit

    found = {name: plain_unit(unit) for name, unit in _pairs(pairs, "--unit", "NAME=UNIT").items()}
    for name, unit in found.items():
        if unit not in COLUMN_UNITS:
            raise click.BadParameter(f"{name}={unit}: expected one of {', '.join(COLUMN_UNITS)}", param_hint="--unit")
    return found


def time_unit_of(unit: str, form: str) -> str:
    """The unit of `--time-unit`; empty if it was not given."""
    from gateway.reporting.recordings.times import TIME_UNITS
    from talc.units import plain_unit

    unit = plain_unit(unit)
    if unit and unit not in TIME_UNITS:
        raise click.BadParameter(f"{unit!r}: expected one of {', '.join(TIME_UNITS)}", param_hint="--time-unit")
    if unit and form:
        raise click.UsageError("--time-unit is for times that are plain numbers, --time-format for others")
    return unit


def skipped_lines(texts: tuple[str, ...]) -> tuple[tuple[int, int], ...]:
    """First and last of each range of lines of `--skip`."""
    from gateway.reporting.recordings.layout import line_ranges

    try:
        return line_ranges(texts)
    except ValueError as error:
        raise click.BadParameter(str(error), param_hint="--skip") from None


def time_zone_of(name: str | None) -> ZoneInfo | None:
    """The time zone of `--time-zone`; None if it was not given."""
    try:
        return None if name is None else ZoneInfo(name)
    except (ZoneInfoNotFoundError, ValueError, OSError):
        raise click.BadParameter(
            f"{name!r}: unknown time zone on this computer; expected a name like Europe/Zurich",
            param_hint="--time-zone",
        ) from None


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


def shifts_of(text: str) -> tuple[time, ...]:
    """The times of day at which shifts begin, in order."""
    try:
        parts = [part.strip().partition(":") for part in text.split(",") if part.strip()]
        found = {time(int(hour), int(minute)) for hour, _, minute in parts}
    except ValueError:
        raise click.BadParameter(
            f"{text!r}: expected times of day such as 06:00,14:00,22:00", param_hint="--shifts"
        ) from None
    return tuple(sorted(found))


def address_of(text: str) -> tuple[str, int]:
    """Host and port of `--listen`; [::1]:8080 for IPv6."""
    host, _, port = text.rpartition(":")
    host = host[1:-1] if host.startswith("[") and host.endswith("]") else host
    if not host or not port.isdecimal() or not 0 <= int(port) <= 65535 or (text.count(":") > 1 and text[0] != "["):
        raise click.BadParameter(f"{text!r}: expected HOST:PORT, such as 127.0.0.1:8080", param_hint="--listen")
    return host, int(port)


def print_hash() -> None:
    """Ask for a password, twice on a terminal, and print its hash."""
    from gateway.runtime.passwords import make_hash

    password = click.prompt("password", hide_input=True, confirmation_prompt=True, err=True)
    click.echo(make_hash(password))
