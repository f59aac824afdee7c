"""Reports of `doctor` on files with keys, certificates and passwords that cannot be read, or are of no use."""

import os
import pwd
import shlex
import subprocess
from collections.abc import Iterator, Mapping
from pathlib import Path

from pydantic import BaseModel

from drivers.bounded_file import opened
from gateway.config.model import GatewayConfig
from gateway.config.problems import Problem
from gateway.model.codes import NoticeCode
from gateway.model.text import Text, Value

_SECRETS = ("key_file", "key", "private_key", "password_file", "users_file")
_PUBLIC = ("certificate", "server_certificate", "authority")


_SPOILT = {
    "key_file": NoticeCode.KEY_SPOILT,
    "users_file": NoticeCode.USERS_SPOILT,
    "password_file": NoticeCode.PASSWORD_SPOILT,
    "key": NoticeCode.PAIR_SPOILT,
}


def unread_files(config: GatewayConfig) -> Mapping[str, Text]:
    """Every file with a key, a certificate or a password that cannot be read, by section and field as in a Problem.

    Root can read all of them: it asks for the user who owns the database, as whom the service runs.
    """
    user = _owner(config.storage.path) if os.geteuid() == 0 else None
    found = {}
    for field, path, harm, page in _named(config):
        name = field.rsplit(maxsplit=1)[-1]
        where: dict[str, Value] = {"field": field, "path": str(path), "harm": harm}
        try:
            with opened(path) as file:
                file.read(1)
        except FileNotFoundError:
            code = NoticeCode.SECRET_ABSENT if name in _SECRETS else NoticeCode.FILE_ABSENT
            found[field] = Text(code, **where, page=page, name=name)
        except OSError as error:
            found[field] = Text(NoticeCode.FILE_UNREADABLE, **where, error=error.strerror)
        else:
            if user is not None and not _may_read(user, path):
                found[field] = Text(NoticeCode.FILE_OF_OTHERS, **where, user=user.pw_name)
    return found


def spoilt_file(config: GatewayConfig, problem: Problem) -> Text:
    """Of a file that can be read and is of no use. problem: one of `credential_problems`"""
    name = problem.where.rsplit(maxsplit=1)[-1]
    path, harm, page = next((path, harm, page) for field, path, harm, page in _named(config) if field == problem.where)
    code = _SPOILT.get(name, NoticeCode.CERTIFICATE_SPOILT)
    return Text(code, problem=str(problem), harm=harm, page=page, quoted=shlex.quote(str(path)))


def _owner(database: Path) -> pwd.struct_passwd | None:
    """Who owns the database, or its folder before there is one; None: root, or nobody with a name."""
    try:
        uid = (database if database.exists() else database.parent).stat().st_uid
        return pwd.getpwuid(uid) if uid else None
    except (OSError, KeyError):
        return None


def _may_read(user: pwd.struct_passwd, path: Path) -> bool:
    """Asks the system as that user, since permissions are more than a file's mode: folders, groups, lists of access."""
    groups = os.getgrouplist(user.pw_name, user.pw_gid)
    asked = ["test", "-r", str(path)]
    done = subprocess.run(asked, user=user.pw_uid, group=user.pw_gid, extra_groups=groups, cwd="/", check=False)
    return done.returncode == 0


def _named(config: GatewayConfig) -> Iterator[tuple[str, Path, Text, str]]:
    """Field, file, what does not work without a good one, and the page that says how it is made."""
    telemetry = config.telemetry
    if telemetry.enabled:
        silent = Text(NoticeCode.NOBODY_HEARS)
        for section, part in (("[telemetry.tls]", telemetry.tls), ("[telemetry]", telemetry)):
            for name, path in _files(part):
                yield f"{section} {name}", path, silent, "docs/site.md"
        for operator in telemetry.operators:
            deaf = Text(NoticeCode.COMMANDS_REFUSED, operator=operator.name)
            yield f"[[telemetry.operator]] '{operator.name}', key_file", operator.key_file, deaf, "docs/commands.md"
    if config.nc is not None:
        for name, path in _files(config.nc):
            page = "docs/agent.md" if name == "key_file" else "docs/nc.md"
            yield f"[nc] {name}", path, Text(NoticeCode.NC_NOT_TO_CONNECT), page
    for bus in config.buses:
        for name, path in _files(bus):
            unread = Text(NoticeCode.BUS_NOT_TO_READ, bus=bus.name)
            yield f"bus '{bus.name}', {name}", path, unread, "docs/devices.md"


def _files(section: BaseModel) -> Iterator[tuple[str, Path]]:
    """The set fields of a section that name such files."""
    fields = dict(section)
    for name in (*_PUBLIC, *_SECRETS):
        if isinstance(path := fields.get(name), Path):
            yield name, path
