"""PostgreSQL, Debian's database server, for tests with marker `peer`: a separate cluster on loopback."""

import os
import pwd
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psycopg

from tests.benches.free_port import free_port
from tests.benches.plant_authority import PlantAuthority

_LIMIT_S = "600"
"""Only for a server that hangs; `pg_ctl` returns when the server accepts connections, or has ended."""


class Postgres:
    """A cluster in its own folder, with the role `site` that may do everything. As it refuses root, it runs as
    Debian's user `postgres` where the tests are root's. It offers TLS; the role `guarded`, when it is made, needs TLS
    and a password.

    folder: new, and where another user may reach it
    """

    def __init__(self, folder: Path) -> None:
        found = sorted(Path("/usr/lib/postgresql").glob("*/bin/pg_ctl"))
        assert found, "PostgreSQL is missing: install Debian's postgresql"
        self._programs, self._user = found[-1].parent, "postgres" if os.geteuid() == 0 else None
        self.port, self.data, self._log = free_port(), folder / "data", folder / "log"
        self._own(folder)
        self._call("initdb", "--username=site", "--auth=trust", "--encoding=UTF8", "--locale=C", "--no-sync")
        plant = PlantAuthority(folder / "plant")
        self.authority, (certificate, key) = plant.path, plant.issue("database")
        self._own(key)
        lines = {
            "listen_addresses": "127.0.0.1", "port": str(self.port), "unix_socket_directories": str(folder),
            "fsync": "off", "ssl": "on", "ssl_cert_file": str(certificate), "ssl_key_file": str(key),
        }  # fmt: skip
        with (self.data / "postgresql.conf").open("a", encoding="utf-8") as file:
            file.writelines(f"{name} = '{value}'\n" for name, value in lines.items())
        rules = self.data / "pg_hba.conf"
        guarded = "hostssl all guarded 127.0.0.1/32 scram-sha-256\nhost all guarded 127.0.0.1/32 reject\n"
        rules.write_text(guarded + rules.read_text("utf-8"), encoding="utf-8")

    def _own(self, path: Path) -> None:
        """Give a file or folder to the server's user."""
        if self._user is not None:
            user = pwd.getpwnam(self._user)
            os.chown(path, user.pw_uid, user.pw_gid)

    def url(self, database: str = "postgres", user: str = "site") -> str:
        """The address of a database on loopback; a busy computer may take its time to connect."""
        return f"postgresql://{user}@127.0.0.1:{self.port}/{database}?connect_timeout={_LIMIT_S}"

    def start(self) -> None:
        """Returns when it accepts connections."""
        self._call("pg_ctl", "start", "--wait", "--timeout", _LIMIT_S, "--log", str(self._log))

    def stop(self) -> None:
        """Stop as if killed: all processes end at once, and the next start recovers."""
        self._call("pg_ctl", "stop", "--mode=immediate", "--wait", "--timeout", _LIMIT_S)

    def query(self, database: str, statement: str) -> list[dict[str, Any]]:
        """Rows of a statement, over a separate connection."""
        with psycopg.connect(self.url(database), autocommit=True) as connection:
            cursor = connection.cursor(row_factory=psycopg.rows.dict_row)
            cursor.execute(statement.encode())
            return cursor.fetchall() if cursor.description else []

    def created(self, database: str) -> str:
        """Address of a new database."""
        self.query("postgres", f"CREATE DATABASE {database}")
        return self.url(database)

    def _call(self, program: str, *words: str) -> None:
        with self._out() as out:
            done = subprocess.run(
                [str(self._programs / program), "--pgdata", str(self.data), *words],
                stdout=out, stderr=out, user=self._user, group=self._user, extra_groups=[] if self._user else None,
                cwd="/", check=False,
            )  # fmt: skip
            out.seek(0)
            said = out.read()
        log = self._log.read_text("utf-8", errors="replace") if self._log.exists() else ""
        assert done.returncode == 0, f"{program} {words}: {said}\n{log}"

    @staticmethod
    def _out() -> Any:
        return tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace")


@contextmanager
def postgres() -> Iterator[Postgres]:
    """A server that runs."""
    folder = Path(tempfile.mkdtemp(prefix="talc-postgres-"))
    try:
        server = Postgres(folder)
        server.start()
        try:
            yield server
        finally:
            server.stop()
    finally:
        shutil.rmtree(folder)
