"""A site in PostgreSQL: the rows of a batch, and how far the machine is collected, change in one transaction.

An interrupted transaction leaves nothing behind, and the collector asks a gateway for more only after it was committed.
"""

import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import msgspec
import psycopg
from psycopg import pq
from psycopg.conninfo import conninfo_to_dict, make_conninfo

from drivers.bounded_file import bytes_of
from drivers.bus_settings import is_loopback
from drivers.error_words import in_words
from gateway.listeners.collect.folder import CollectError, Commit
from gateway.listeners.collect.progress import CollectProgress, TablePlace, checked_machine
from gateway.listeners.collect.relations import SiteRelations

_DEFAULTS = {
    "application_name": "talc-gateway collect",
    "connect_timeout": "10",
    "keepalives_idle": "30",
    "keepalives_interval": "10",
    "keepalives_count": "3",
    "tcp_user_timeout": "60000",
}
"""Parameters of the connection, where the address does not say otherwise. A server that has vanished is noticed in a
minute."""
_SESSION = """
    SET TIME ZONE 'UTC'; SET tcp_keepalives_idle = 30; SET tcp_keepalives_interval = 10; SET tcp_keepalives_count = 3
"""
"""So that the server notices a collector that has vanished, and gives up its lock."""
_LOCK = "SELECT pg_advisory_lock(hashtext('talc-gateway collect'))"
_LOCK_WAIT_S = 5.0
"""The server takes a moment to notice that a collector has ended, and only then gives up its lock."""
_PROGRESS = """
    CREATE TABLE IF NOT EXISTS talc.progress (machine text PRIMARY KEY, batch bigint NOT NULL, places jsonb NOT NULL)
"""
_COUNT = """
    INSERT INTO talc.progress AS kept (machine, batch, places) VALUES (%s, %s, %s)
    ON CONFLICT (machine) DO UPDATE SET batch = excluded.batch, places = excluded.places
    WHERE kept.batch = excluded.batch - 1
"""
_PLACES = msgspec.json.Decoder(dict[str, tuple[TablePlace, ...]])

DatabaseConnection = psycopg.Connection[tuple[Any, ...]]


def database_parameters(url: str) -> dict[str, Any]:
    """Parameters of the connection to `postgresql://USER@HOST/DATABASE`.

    Without `sslmode`, a server beyond loopback must prove by its certificate that it has the name in the address.

    Raises ValueError for an invalid address, or one with a password: `ps` shows it to every user of this computer.
    """
    try:
        given = conninfo_to_dict(url)
    except psycopg.ProgrammingError as error:
        raise ValueError(f"no address of a database: {what_is_wrong(error)}") from None
    if given.get("password"):
        raise ValueError("a password in the address is seen by every user of this computer; put it into a file")
    hosts = str(given.get("hostaddr") or given.get("host") or "").split(",")
    near = all(not host or host.startswith("/") or is_loopback(host) for host in hosts)
    return {**_DEFAULTS, **({} if near else {"sslmode": "verify-full"}), **given}


def places_of(machine: str, text: str) -> Mapping[str, tuple[TablePlace, ...]]:
    """How far each table of a machine is collected, of its `places` in talc.progress. Raises ValueError."""
    try:
        return _PLACES.decode(text)
    except msgspec.DecodeError as error:
        raise ValueError(
            f"talc.progress, machine {machine}, places: {error}; restore it from a backup with all of the schema talc"
        ) from error


class SiteDatabase:
    """One site's, in the schema `talc` of a database, as a context manager; one collector writes to it at a time.

    Parameters
    ----------
    url: postgresql://USER@HOST/DATABASE, with any of libpq's parameters
    password_file: contains only the user's password; read at each connection
    lock_wait_s: how long a connection waits for the lock of another collector

    Raises ValueError as `database_parameters`; CollectError on entry when the database cannot be used, or when another
    collector uses it. One that cannot be reached is waited for by `ready`.
    """

    def __init__(self, url: str, password_file: Path | None = None, *, lock_wait_s: float = _LOCK_WAIT_S) -> None:
        self._parameters, self._password_file = database_parameters(url), password_file
        self._lock_wait_s = lock_wait_s
        self._connection: DatabaseConnection | None = None
        self._relations, self._one = SiteRelations(), threading.Lock()

    def __enter__(self) -> Self:
        if not _is_away(self._parameters):
            self.ready()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._give_up()

    def ready(self) -> None:
        """Connect where there is no connection. Raises CollectError while the database cannot be used."""
        with suppress(CollectError), self._transaction() as connection:
            connection.execute("SELECT 1")
            return
        with self._transaction():  # the first one may only have found that the server was started again
            pass

    def progress(self, machine: str) -> CollectProgress:
        """How far a machine is collected.

        Raises ValueError for a name that no gateway has or what is no progress, CollectError.
        """
        name = checked_machine(machine)
        with self._transaction() as connection:
            found = connection.execute(
                "SELECT batch, places::text FROM talc.progress WHERE machine = %s", (name,)
            ).fetchone()
        if found is None:
            return CollectProgress()
        return CollectProgress(found[0], places_of(name, found[1]))

    def collected_as(self, table: str, epoch: str) -> tuple[str, CollectProgress] | None:
        """The machine of which this epoch of a table is collected, and how far. Raises CollectError."""
        with self._transaction() as connection:
            found = connection.execute("SELECT machine, batch, places::text FROM talc.progress ORDER BY machine")
            rows = found.fetchall()
        for name, batch, text in rows:
            with suppress(ValueError):  # a damaged one holds up its own machine, which says so
                progress = CollectProgress(batch, places_of(name, text))
                if progress.last(table, epoch) is not None:
                    return name, progress
        return None

    def add(self, machine: str, commit: Commit) -> CollectProgress:
        """Make a batch count; when this returns, its rows and the progress are committed.

        Raises CollectError or ValueError; then ask `progress` again, which says whether it counts.
        """
        name, batch = checked_machine(machine), commit.progress.batch + 1
        with self._transaction() as connection:
            places = msgspec.json.encode(commit.progress.places).decode()
            if not connection.execute(_COUNT, (name, batch, places)).rowcount:
                raise CollectError("another program has changed talc.progress in the database; reading it again")
            for table, rows in commit.rows.items():
                self._relations.add(connection, name, table, rows)
        return CollectProgress(batch, commit.progress.places)

    @contextmanager
    def _transaction(self) -> Iterator[DatabaseConnection]:
        """Committed at the end. After any failure the connection is given up, and with it what was not committed."""
        with self._one:
            try:
                if self._connection is None:
                    self._connection = self._connected()
                yield self._connection
                self._connection.commit()
            except psycopg.Error as error:
                self._give_up()
                raise CollectError(f"database: {what_is_wrong(error)}") from error
            except BaseException:
                self._give_up()
                raise

    def _connected(self) -> DatabaseConnection:
        connection = connect_to(self._parameters, self._password_file)
        try:
            _prepare(connection, self._lock_wait_s)
        except BaseException:
            connection.close()
            raise
        self._relations = SiteRelations()
        return connection

    def _give_up(self) -> None:
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.close()


def connect_to(parameters: Mapping[str, Any], password_file: Path | None) -> DatabaseConnection:
    """A new connection with the password that the file holds now. Raises CollectError, psycopg.Error."""
    if password_file is not None:
        parameters = {**parameters, "password": _password(password_file)}
    return psycopg.connect(**parameters)


def _is_away(parameters: Mapping[str, Any]) -> bool:
    """Whether the server does not answer, or is just starting or stopping. Whom it lets in, and how, does not count."""
    unencrypted = {name: value for name, value in parameters.items() if name != "sslnegotiation"}
    found = pq.PGconn.ping(make_conninfo(**{**unencrypted, "sslmode": "disable"}).encode())
    return found in (pq.Ping.REJECT, pq.Ping.NO_RESPONSE)


def what_is_wrong(error: psycopg.Error) -> str:
    """Without the statement that it stands in."""
    return next(iter(str(error).splitlines()), "") or type(error).__name__


def _password(file: Path) -> str:
    try:
        return bytes_of(file).decode().strip()
    except (OSError, UnicodeDecodeError) as error:
        raise CollectError(f"{file}: the password cannot be read: {in_words(error)}") from error


def _prepare(connection: DatabaseConnection, lock_wait_s: float) -> None:
    """Settings of the session, the lock, and what must exist."""
    connection.execute(_SESSION)
    connection.execute("SELECT set_config('lock_timeout', %s, true)", (f"{lock_wait_s * 1e3:.0f}ms",))
    try:
        connection.execute(_LOCK)
    except psycopg.errors.LockNotAvailable:
        raise CollectError("database: another collector writes to it") from None
    if (encoding := _one(connection, "SHOW server_encoding")) != "UTF8":
        raise CollectError(f"database: its encoding is {encoding}; create one with ENCODING 'UTF8'")
    if not _one(connection, "SELECT count(*) FROM pg_namespace WHERE nspname = 'talc'"):
        connection.execute("CREATE SCHEMA talc")
    connection.execute(_PROGRESS)
    connection.commit()


def _one(connection: DatabaseConnection, query: str) -> object:
    found = connection.execute(query.encode()).fetchone()
    return None if found is None else found[0]
