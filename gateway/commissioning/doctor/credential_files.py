"""Reports of `doctor` on files with keys, certificates and passwords that cannot be read, or are of no use."""

import errno
import os
import pwd
import re
import shlex
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from pydantic import BaseModel

from gateway.config.model import GatewayConfig
from gateway.config.problems import Problem

_SECRETS = ("key_file", "key", "private_key", "password_file", "users_file")
_PUBLIC = ("certificate", "server_certificate", "authority")


@dataclass(frozen=True, slots=True)
class UnreadFile:
    """A file that a configuration names and that cannot be read."""

    field: str
    """Section and field, as in a Problem."""
    path: Path
    error: OSError
    why: str
    page: str
    """How such a file is made."""
    reader: str = ""
    """The user who has to read it, if that is not this process's."""

    @property
    def what(self) -> str:
        """Which file, of which setting."""
        absent = isinstance(self.error, FileNotFoundError)
        return f"{self.field}: '{self.path}' " + (
            "does not exist" if absent else f"cannot be read: {self.error.strerror}"
        )

    @property
    def remedy(self) -> str:
        """What to do."""
        name = self.field.rsplit(maxsplit=1)[-1]
        secret = name in _SECRETS
        if isinstance(self.error, FileNotFoundError):
            guard = ", readable only by the gateway's user (chmod 600)" if secret else ""
            return f"make the file ({self.page}) or copy it there{guard}, or change {name} in the configuration"
        if self.reader:
            return f"chown {self.reader} {self.path}; or LoadCredential= in a drop-in (docs/install-pi.md)"
        return "let the gateway's user read it; if it already may, run `doctor` as that user or as root"


def unread_files(config: GatewayConfig) -> Iterator[UnreadFile]:
    """Every file with a key, a certificate or a password that cannot be read.

    Root can read all of them: it asks for the user who owns the database, as whom the service runs.
    """
    user = _owner(config.storage.path) if os.geteuid() == 0 else None
    for field, path, harm, page in _named(config):
        why = f"without it {harm}"
        try:
            with path.open("rb") as file:
                file.read(1)
        except OSError as error:
            yield UnreadFile(field, path, error, why, page)
        else:
            if user is not None and not _may_read(user, path):
                refused = PermissionError(errno.EACCES, f"not by {user.pw_name}, the user who owns the database")
                yield UnreadFile(field, path, refused, why, page, user.pw_name)


def spoilt_file(config: GatewayConfig, problem: Problem) -> tuple[str, str]:
    """Why it matters that a file can be read and is of no use, and what to do. problem: one of `credential_problems`"""
    name = problem.where.rsplit(maxsplit=1)[-1]
    path, harm, page = next((path, harm, page) for field, path, harm, page in _named(config) if field == problem.where)
    line = re.search(r"line \d+", problem.what.removeprefix(f"'{path}'"))
    todo = {
        "key_file": f"make a new key: openssl rand -hex 32 > {shlex.quote(str(path))}; its owner needs the same one",
        "users_file": f"correct {line[0] if line else 'the file'}: expected a line user:password for each user",
        "password_file": "write the password into the file",
        "key": "copy the key that belongs to the certificate, or make both again",
    }
    return harm, f"{todo.get(name, 'renew the file, or set the clock of this computer if it is wrong')} ({page})"


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


def _named(config: GatewayConfig) -> Iterator[tuple[str, Path, str, str]]:
    """Field, file, what does not work without a good one, and the page that says how it is made."""
    telemetry = config.telemetry
    if telemetry.enabled:
        silent = "nobody on another computer can hear the gateway"
        for section, part in (("[telemetry.tls]", telemetry.tls), ("[telemetry]", telemetry)):
            for name, path in _files(part):
                yield f"{section} {name}", path, silent, "docs/secure-telemetry.md"
        for operator in telemetry.operators:
            deaf = f"every command of '{operator.name}' is refused"
            yield f"[[telemetry.operator]] '{operator.name}', key_file", operator.key_file, deaf, "docs/commands.md"
    if config.nc is not None:
        for name, path in _files(config.nc):
            page = "docs/agent.md" if name == "key_file" else "docs/nc.md"
            yield f"[nc] {name}", path, "the gateway cannot connect to the control", page
    for bus in config.buses:
        for name, path in _files(bus):
            yield f"bus '{bus.name}', {name}", path, f"bus '{bus.name}' cannot be read", "docs/devices.md"


def _files(section: BaseModel) -> Iterator[tuple[str, Path]]:
    """The set fields of a section that name such files."""
    fields = dict(section)
    for name in (*_PUBLIC, *_SECRETS):
        if isinstance(path := fields.get(name), Path):
            yield name, path
