"""The base of every table in a file, a frozen model that rejects unknown keys and wrong types; common field types."""

import json
import re
from collections.abc import Callable, Mapping
from ipaddress import ip_address
from pathlib import Path
from typing import Annotated, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationInfo

from drivers.base import SetupError
from drivers.text import Text, shown

_URL = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*://")
_REMOTE = re.compile(r"(?:rfc2217|socket)://(?:\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9._-]+):(?P<port>\d{1,5})/?")
_WINDOWS_PORT = re.compile(r"(?i:com)\d+")
_NAME = re.compile(r"[\w.-]+")
OTHER_ENCODING = "cp1252"
"""The other encoding of a file that a profile refers to (DBC, EDS)."""
LARGEST = 1e9
"""Limit of a number that states none: 30 years in seconds."""


class Section(BaseModel):
    """One table of a file. The text under each field appears in the reference.

    It is read there and not when a program starts (`use_attribute_docstrings`), as that parses every source file. A
    section's validator is made when it is first needed: most sections are never used by themselves.
    """

    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, hide_input_in_errors=True, defer_build=True
    )


S = TypeVar("S", bound=BaseModel)


def strictly(kind: type[S], data: Mapping[str, object] | str, context: Mapping[str, object] | None = None) -> S:
    """The model that TOML data, or JSON text, describe. Raises pydantic.ValidationError.

    context: additional input of validators; see `FilePath`
    """
    # Via JSON, so that strict types hold (no "9600" for 9600) while lists and texts still become tuples and paths.
    text = data if isinstance(data, str) else json.dumps(dict(data), default=_plain)
    return kind.model_validate_json(text, strict=True, context=None if context is None else dict(context))


def _plain(value: object) -> object:
    """Types that JSON does not have: any mapping becomes a table, a date becomes text."""
    return dict(value) if isinstance(value, Mapping) else str(value)


def wrong(what: Text, *at: str | int) -> SetupError:
    """For validators: the error of the wrong field at `at`, below the validator's own field."""
    return SetupError(what, field=at)


def both_or_neither(first: str, given: object, second: str, other: object) -> None:
    """Raises ValueError if one of these two fields is given, and the other is None."""
    if (given is None) != (other is None):
        raise ValueError(Text("both_or_neither", first=first, second=second))


def user_and_password(user: str | None, password_file: Path | None) -> None:
    """Raises ValueError for one without the other."""
    both_or_neither("user", user, "password_file", password_file)


def beside_the_file(path: Path, info: ValidationInfo) -> Path:
    """A relative path starts at the file's folder (`folder` of the context), not at the working directory."""
    if "\0" in str(path):
        raise ValueError(Text("path_null", value=shown(str(path))))
    if not path.name:  # also an empty text, which would be the folder
        raise ValueError(Text("path_no_file", value=shown(str(path))))
    folder = info.context.get("folder") if isinstance(info.context, dict) else None
    return path if folder is None or path.is_absolute() else Path(folder) / path


def _believable(value: float) -> float:
    """A thread that shall wait for longer than some 1e10 s fails instead."""
    if value > LARGEST:
        raise ValueError(Text("expected", value=f"{value:g}", wanted=Text("at_most", limit=LARGEST)))
    return value


def in_form(pattern: str, expected: str) -> Callable[[str], str]:
    """A check of a text's form that returns the text, or raises ValueError with a message for a person."""
    compiled = re.compile(pattern)

    def check(text: str) -> str:
        if not compiled.fullmatch(text):
            raise ValueError(Text("expected", value=shown(text), wanted=Text(expected)))
        return text

    return check


def matching(pattern: str, expected: str) -> AfterValidator:
    """The same as a validator of a field."""
    return AfterValidator(in_form(pattern, expected))


def name_beside_the_file(name: str, info: ValidationInfo) -> str:
    """The same for the name of a port of this computer, which stays a text. A URL is refused."""
    if (url := _URL.match(name)) is not None:
        raise ValueError(Text("port_no_url", value=shown(name), scheme=url[0]))
    return str(beside_the_file(Path(name), info))


def _serial_port(name: str, info: ValidationInfo) -> str:
    """The name of a port of this computer, or the URL of one of a device server."""
    found = _REMOTE.fullmatch(name)
    if found is None and not _URL.match(name) and not _WINDOWS_PORT.fullmatch(name):
        return name_beside_the_file(name, info)
    if found is None or not 1 <= int(found["port"]) <= 0xFFFF:
        raise ValueError(Text("port_form", value=shown(name)))
    return name


_NUMBERS = re.compile(r"\d+(?:[.,]\d+)+|(?=(?:\w*\.){3}\w*$)(?:\d+\.)*[A-Za-z\d]{1,3}(?:\.\d+)*")
"""Also four parts of which one is no number, such as 10.0.O.1."""


def host_name(text: str) -> str:
    """A name or an address: neither a URL nor with a port. Raises ValueError."""
    try:
        text.encode("idna")  # as whatever looks it up: no part of it is empty or longer than 63 characters
        named = _NAME.fullmatch(text) is not None and bool(text.strip(".")) and not _NUMBERS.fullmatch(text)
    except UnicodeError:
        named = False
    if not named:
        try:
            ip_address(text)
        except ValueError:
            code = "host_numbers" if _NUMBERS.fullmatch(text) else "host_form"
            raise ValueError(Text(code, value=shown(text))) from None
    return text


def without_brackets(host: str) -> str:
    """A host as a URL has it: an IPv6 address is in brackets there."""
    return host.removeprefix("[").removesuffix("]")


def host_and_port(host: str, port: int) -> str:
    """As in a URL: an IPv6 address is in brackets."""
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


FilePath = Annotated[Path, AfterValidator(beside_the_file)]
NotEmpty = Annotated[str, Field(min_length=1)]
HostName = Annotated[NotEmpty, AfterValidator(host_name)]
"""Name or address of a host."""
SerialPort = Annotated[NotEmpty, AfterValidator(_serial_port)]
Port = Annotated[int, Field(ge=1, le=65535)]
"""A TCP or UDP port."""
LONGEST_ANSWER_S = 60
AnswerTime = Annotated[float, Field(gt=0, le=LONGEST_ANSWER_S)]
"""How long one answer of a device may take at most, s; a larger number is most likely in milliseconds."""
ServerTime = Annotated[float, Field(gt=0, le=3600)]
"""How long a server may take at most, s: a broker may have a topic that changes every few minutes."""
Positive = Annotated[float, Field(gt=0), AfterValidator(_believable)]
NotNegative = Annotated[float, Field(ge=0), AfterValidator(_believable)]
