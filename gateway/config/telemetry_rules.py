"""Checks of [telemetry]: what contradicts itself, and the files of certificates, keys and passwords."""

from collections import Counter
from collections.abc import Callable, Generator, Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from drivers.bounded_file import bytes_of
from drivers.credential_files import ENDS_SOON, secret_cautions
from drivers.error_words import in_words
from drivers.signature import shared_key
from gateway.config.problems import Problem
from gateway.config.telemetry import Telemetry, TelemetryTls
from gateway.model.codes import NoticeCode
from gateway.model.text import Text, text_of

if TYPE_CHECKING:
    from cryptography import x509

T = TypeVar("T")


def telemetry_problems(telemetry: Telemetry) -> Iterator[Problem]:
    """What contradicts itself; reads no file."""
    if not telemetry.enabled:
        return
    tls = telemetry.tls
    for place in telemetry.listening:
        if place.encrypted and tls.certificate is None:
            yield Problem("[telemetry] listen", Text(NoticeCode.LISTEN_NO_CERTIFICATE, place=place.text))
        if not (place.encrypted or place.local or telemetry.allow_unencrypted):
            yield Problem(
                "[telemetry] listen",
                Text(NoticeCode.LISTEN_UNENCRYPTED, place=place.text),
            )
    for place in telemetry.connecting:
        if place.encrypted and tls.authority is None:
            yield Problem("[telemetry] connect", Text(NoticeCode.CONNECT_NO_AUTHORITY, place=place.text))
    if telemetry.mode == "client" and not (telemetry.connect or telemetry.multicast):
        yield Problem(
            "[telemetry] mode",
            Text(NoticeCode.CLIENT_NO_ROUTER),
        )
    yield from _operator_problems(telemetry)
    if telemetry.readers and not (tls.mutual or telemetry.users_file):
        yield Problem(
            "[telemetry] readers",
            Text(NoticeCode.READERS_NO_NAMES),
        )
    if telemetry.readers and telemetry.connect:
        yield Problem(
            "[telemetry] readers",
            Text(NoticeCode.READERS_OF_ROUTER),
        )


def credential_problems(telemetry: Telemetry, now: datetime) -> Iterator[Problem]:
    """What is wrong with the files that [telemetry] names, at this time. A running gateway continues without them as
    long as it can, so that an expired certificate stops nothing but the telemetry."""
    if not telemetry.enabled:
        return
    tls = telemetry.tls
    certificates = yield from _read("[telemetry.tls] certificate", tls.certificate, _certificates)
    if certificates:
        yield from _dates("[telemetry.tls] certificate", tls.certificate, certificates[0], now)
    yield from _key_problems(tls, certificates[0] if certificates else None)
    for authority in (yield from _read("[telemetry.tls] authority", tls.authority, _certificates)) or ():
        yield from _dates("[telemetry.tls] authority", tls.authority, authority, now)
    password = yield from _read("[telemetry] password_file", telemetry.password_file, _file_text)
    if password is not None and not password.strip():
        yield Problem("[telemetry] password_file", Text(NoticeCode.PASSWORD_EMPTY, path=str(telemetry.password_file)))
    yield from _users_problems(telemetry)
    for operator in telemetry.operators:
        yield from _read(f"[[telemetry.operator]] '{operator.name}', key_file", operator.key_file, shared_key)


def telemetry_cautions(telemetry: Telemetry) -> Iterator[Problem]:
    """What works now and may fail later, or is less safe than it could be. Reads files."""
    if not telemetry.enabled:
        return
    for place in telemetry.connecting:
        if not (place.encrypted or place.local):
            yield Problem("[telemetry] connect", Text(NoticeCode.CONNECT_UNENCRYPTED, place=place.text))
    if telemetry.multicast:
        yield Problem("[telemetry] multicast", Text(NoticeCode.MULTICAST_ANYONE))
    for place in telemetry.listening:
        if telemetry.users_file and not (place.encrypted or place.local):
            yield Problem("[telemetry] users_file", Text(NoticeCode.USERS_UNENCRYPTED, place=place.text))
    for field, path in (
        ("[telemetry.tls] key", telemetry.tls.key),
        ("[telemetry] password_file", telemetry.password_file),
        ("[telemetry] users_file", telemetry.users_file),
        *((f"[[telemetry.operator]] '{one.name}', key_file", one.key_file) for one in telemetry.operators),
    ):
        if path is not None and path.is_file():
            yield from (Problem(field, text) for text in secret_cautions(path))
    for name in ("certificate", "authority"):
        yield from _ends_soon(name, getattr(telemetry.tls, name))


def _operator_problems(telemetry: Telemetry) -> Iterator[Problem]:
    for name, many in Counter(operator.name for operator in telemetry.operators).items():
        if many > 1:
            yield Problem("[[telemetry.operator]] name", Text(NoticeCode.OPERATOR_REPEATED, name=name, count=many))


def _ends_soon(name: str, path: Path | None) -> Iterator[Problem]:
    try:
        found = [] if path is None else _certificates(path)
    except (OSError, ValueError):
        return  # check says it
    now = datetime.now(UTC)
    for ends in sorted(each.not_valid_after_utc for each in found)[:1]:
        if timedelta() < ends - now < ENDS_SOON:
            yield Problem(
                f"[telemetry.tls] {name}", Text(NoticeCode.EXPIRES_SOON, path=str(path), day=f"{ends:%Y-%m-%d}")
            )


def _read(field: str, path: Path | None, reader: Callable[[Path], T]) -> Generator[Problem, None, T | None]:
    """What a file holds; None, and why, if it cannot be read; None if the field is not set."""
    if path is None:
        return None
    try:
        return reader(path)
    except OSError as error:
        yield Problem(field, Text("path_unreadable", path=str(path), why=in_words(error)))
    except ValueError as error:
        yield Problem(field, Text(NoticeCode.FILE_WRONG, path=str(path), why=text_of(error)))
    return None


def _file_text(path: Path) -> str:
    return bytes_of(path).decode()


def _certificates(path: Path) -> "list[x509.Certificate]":
    from gateway.config.pem import certificates  # only where there are any: it loads cryptography

    return certificates(path)


def _public_key(path: Path) -> bytes:
    from gateway.config.pem import public_key

    return public_key(path)


def _dates(field: str, path: Path | None, certificate: "x509.Certificate", now: datetime) -> Iterator[Problem]:
    begins, ends = certificate.not_valid_before_utc, certificate.not_valid_after_utc
    if now > ends:
        yield Problem(field, Text(NoticeCode.EXPIRED, path=str(path), at=ends))
    elif now < begins:
        yield Problem(field, Text(NoticeCode.NOT_YET_VALID, path=str(path), at=begins))


def _key_problems(tls: TelemetryTls, certificate: "x509.Certificate | None") -> Iterator[Problem]:
    public = yield from _read("[telemetry.tls] key", tls.key, _public_key)
    if public is None or certificate is None:
        return
    from gateway.config.pem import der

    if public != der(certificate.public_key()):
        yield Problem(
            "[telemetry.tls] key", Text(NoticeCode.KEY_OF_OTHER, key=str(tls.key), certificate=str(tls.certificate))
        )


def _users_problems(telemetry: Telemetry) -> Iterator[Problem]:
    field, path = "[telemetry] users_file", telemetry.users_file
    text = yield from _read(field, path, _file_text)
    if text is None:
        return
    lines = [(number, line) for number, line in enumerate(text.splitlines(), start=1) if line.strip()]
    if not lines:
        yield Problem(field, Text(NoticeCode.USERS_EMPTY, path=str(path)))
    for number, line in lines:
        user, _, password = line.partition(":")
        if not (user.strip() and password.strip()):
            yield Problem(field, Text(NoticeCode.USERS_LINE, path=str(path), line=number))
        elif not line.strip().isprintable():  # a byte order mark, say: nobody would type this name
            yield Problem(
                field, Text(NoticeCode.USERS_INVISIBLE, path=str(path), line=number, value=repr(line.strip()))
            )
