"""Zenoh's configuration of the gateway's own session and of a reader's, with TLS, passwords and access rules."""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import zenoh

from drivers.bounded_file import bytes_of, check_bounds
from gateway.config.telemetry import Telemetry as TelemetrySettings
from gateway.model.codes import NoticeCode
from gateway.model.text import Text

_LARGEST_QUERY = 1 << 20
"""Bytes: Zenoh's own default is 1 GiB. What is larger is dropped piece by piece, before it is put together."""
_OPEN_MS = 4000
"""How long a connection may take to open: what is away is found away in less than Zenoh's own 10 s."""
_FROM_STRANGERS = {
    "transport/unicast/max_sessions": 100,
    "transport/unicast/accept_pending": 800,
    "transport/unicast/accept_timeout": 3000,
}
"""How many may be connected, how many more may be about to, and for how many ms. While that many silent ones are there
at once, nobody else gets in; each takes some 20 kB."""
_SENDING = ["put", "delete", "declare_queryable", "reply", "liveliness_token"]
"""What only the gateway itself does."""
_READING = ["query", "declare_subscriber", "liveliness_query", "declare_liveliness_subscriber"]
_TLS = "transport/link/tls"
_LOGIN = "transport/auth/usrpwd"


@dataclass(frozen=True, slots=True, kw_only=True)
class Access:
    """A reader's credentials, and the authority that it trusts. PEM files."""

    authority: Path | None = None
    """Certificates of the authority that the other side's certificate must come from; needed for `tls/…`."""
    certificate: Path | None = None
    """Its own, for a gateway or router that asks for one."""
    key: Path | None = None
    """Private key of `certificate`."""
    user: str | None = None
    password: str | None = None


def own_access(settings: TelemetrySettings) -> Access:
    """What the gateway itself uses. Raises OSError if the password cannot be read."""
    tls, password = settings.tls, None
    with suppress(FileNotFoundError):  # Zenoh says so; a pipe would keep it
        check_bounds(tls.authority, tls.certificate, tls.key, settings.users_file)
    if settings.password_file is not None:
        password = bytes_of(settings.password_file).decode().strip()
    return Access(
        authority=tls.authority, certificate=tls.certificate, key=tls.key, user=settings.user, password=password
    )


def session_config(settings: TelemetrySettings) -> zenoh.Config:
    """The gateway's: multicast only if configured; absent peers are retried without limit. Raises OSError."""
    listening = [place.text for place in settings.listening]
    values: dict[str, object] = {
        "mode": settings.mode,
        "listen/endpoints": listening,
        "connect/endpoints": list(settings.connect),
        "scouting/multicast/enabled": settings.multicast,
        "scouting/gossip/enabled": False,
        "timestamping/enabled": True,
        "transport/link/rx/max_message_size": _LARGEST_QUERY,
        **_FROM_STRANGERS,
        "access_control": _rules(settings),
        **_proof(own_access(settings)),
    }
    tls = settings.tls
    if tls.certificate is not None and tls.key is not None:
        values |= {f"{_TLS}/listen_certificate": str(tls.certificate), f"{_TLS}/listen_private_key": str(tls.key)}
    if any(place.encrypted for place in settings.listening):
        values[f"{_TLS}/enable_mtls"] = tls.mutual  # one switch of Zenoh's for who connects and for where it connects
    if settings.users_file is not None:
        values[f"{_LOGIN}/dictionary_file"] = str(settings.users_file)
    if settings.mode == "peer":
        values["connect/exit_on_failure"] = False
    return _config(values)


def reader_config(connect: Sequence[str], access: Access) -> zenoh.Config:
    """Configuration of a program that only reads. Raises ValueError for endpoints that cannot be."""
    values = {"mode": "client", "scouting/multicast/enabled": False, **_proof(access)}
    try:
        return _config({**values, "connect/endpoints": list(connect)})
    except zenoh.ZError:
        shown = ", ".join(connect)
        raise ValueError(Text(NoticeCode.CONNECT_FORM, value=repr(shown))) from None


def page_config(settings: TelemetrySettings, place: str) -> zenoh.Config:
    """Configuration of a program that reads all gateways at one place of `connect`, with what the section says of
    certificates and password. Without a place, it finds others by multicast. It listens nowhere. Raises OSError."""
    where: dict[str, object] = {"mode": "client", "connect/endpoints": [place]}
    if not place:
        where = {"mode": "peer", "listen/endpoints": []}
    return _config(
        {
            **where,
            "scouting/multicast/enabled": not place and settings.multicast,
            "scouting/gossip/enabled": False,
            **_proof(own_access(settings)),
        }
    )


@contextmanager
def reading_session(config: zenoh.Config, refused: Callable[[str], OSError]) -> Iterator[zenoh.Session]:
    """A session of a program that only reads, closed at the end whatever happens inside.

    refused: makes the error that is raised when it does not open, from what happened
    """
    try:
        session = zenoh.open(config)
    except zenoh.ZError as error:
        raise refused(without_path(error)) from error
    try:
        yield session
    finally:
        session.close()


def without_path(error: zenoh.ZError) -> str:
    """What happened, without the place inside the library."""
    return str(error).split(" at /")[0].strip()


def _proof(access: Access) -> dict[str, object]:
    values: dict[str, object] = {}
    if access.authority is not None:
        values[f"{_TLS}/root_ca_certificate"] = str(access.authority)
    if access.certificate is not None and access.key is not None:
        values[f"{_TLS}/connect_certificate"] = str(access.certificate)
        values[f"{_TLS}/connect_private_key"] = str(access.key)
        values[f"{_TLS}/enable_mtls"] = access.authority is not None
    if values:
        values[f"{_TLS}/close_link_on_expiration"] = True
    if access.user is not None:
        values |= {f"{_LOGIN}/user": access.user, f"{_LOGIN}/password": access.password or ""}
    return values


def _rules(settings: TelemetrySettings) -> dict[str, object]:
    """Nothing that others send comes in or is passed on: a peer would hand a forged sample to its other clients. With
    readers, only these read."""
    every = {"id": "everyone"}
    if not settings.readers:
        rule = {"id": "send", "permission": "deny", "flows": ["ingress"], "messages": _SENDING, "key_exprs": ["**"]}
        return _control("allow", [rule], [every])
    keys = [f"{settings.prefix}/**"]
    rules = [
        {"id": "read", "permission": "allow", "flows": ["ingress"], "messages": _READING, "key_exprs": keys},
        {"id": "hear", "permission": "allow", "flows": ["egress"], "messages": _SENDING, "key_exprs": keys},
    ]
    names = list(settings.readers)
    subjects: list[dict[str, object]] = []
    if settings.tls.mutual:
        subjects.append({"id": "certificates", "cert_common_names": names})
    if settings.users_file is not None:
        subjects.append({"id": "users", "usernames": names})
    return _control("deny", rules, subjects)


def _control(
    default: str, rules: Sequence[Mapping[str, object]], subjects: Sequence[Mapping[str, object]]
) -> dict[str, object]:
    policy = {"rules": [rule["id"] for rule in rules], "subjects": [subject["id"] for subject in subjects]}
    return {
        "enabled": True,
        "default_permission": default,
        "rules": rules,
        "subjects": subjects,
        "policies": [policy],
    }


def _config(values: Mapping[str, object]) -> zenoh.Config:
    """Without shared memory: what passes is small, and a session would not open where locking pages is denied."""
    config = zenoh.Config()
    usual = {"transport/shared_memory/enabled": False, "transport/unicast/open_timeout": _OPEN_MS}
    for key, value in {**usual, **values}.items():
        config.insert_json5(key, json.dumps(value))
    return config
