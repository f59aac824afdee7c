"""The store: everything that happened, in one SQLite file; bounded, safe against power cuts, exact enough to replay.

The journal is a write-ahead log, synchronised with the disk at every commit (gateway.storage.schema says why).
Decisions and models are committed at once, because a decision that was acted upon must not be lost; readings are
committed in groups, after at most `commit_s`.
"""

import asyncio
import sqlite3
from collections.abc import Sequence
from contextlib import AbstractContextManager, closing, suppress
from pathlib import Path
from typing import Self, assert_never

from drivers.base import Clock
from gateway.config.applied import ConfigurationApplied
from gateway.config.extended import stored_configuration
from gateway.model.events import (
    CommandGiven,
    CompensationStepped,
    Configured,
    DecisionMade,
    EventReported,
    ForecastMade,
    FrameMade,
    GatewayEvent,
    HealthChecked,
    MeasurementEnded,
    ModelsAdopted,
    OutlookChanged,
    ProbingRequested,
    ReadingsTaken,
    ReasonsGiven,
    SensorsJudged,
    StorageChanged,
    StoreHealth,
)
from gateway.model.text import NOTHING, Text, text_of
from gateway.model.wording import worded
from gateway.storage import rows
from gateway.storage.answers import long_work
from gateway.storage.damage import unreadable_rows
from gateway.storage.epochs import begin_epoch
from gateway.storage.faults import DamagedError, StoreError
from gateway.storage.learnt import Learnt
from gateway.storage.lock import FileLock, link_followed
from gateway.storage.mending import Known, begin_again, mend
from gateway.storage.outside import check_emptied, write_outside
from gateway.storage.place import check_left
from gateway.storage.readings import MOST_BOOTS, Channels, Pruning, Retention, last_boot
from gateway.storage.schema import UNREADABLE, connect, is_damage, make_schema, unusable
from gateway.storage.snapshot import Snapshot
from gateway.storage.timing import WriterTiming
from gateway.storage.waiting import WaitingKind
from gateway.storage.writer import DatabaseWriter
from talc.frame import Why

_RETENTION = Retention()
_CHANNEL = "INSERT OR IGNORE INTO channel VALUES (?, ?, ?)"
_ON_DISK_WITHIN_S = 5.0
"""How long a probing request waits for its number to be on the disk."""


class Store:
    """Writes one gateway's database, as a context manager. One gateway per database.

    Parameters
    ----------
    path: the file; it and its folder are created if missing
    boot: identifies this run of the process; with a reading's sequence number it identifies duplicates
    clock: for the time of events
    commit_s: readings are committed at least this often, in real seconds
    retention: how long readings, compensation steps and reasons stay
    retry_s: interval between attempts after a failure, in real seconds
    look_s: how often it looks whether the file is still at its path, and uncut, in real seconds
    hangs_after_s: a disk that takes longer for one statement or commit counts as failing, in real seconds
    silent_s: at the end, the longest that the disk may take for one statement or commit, in real seconds; then the
        process should end, as the lock is only released by that
    origin: identifies this start of this computer (`ServiceClock.origin`); empty: not known

    Raises StoreError: not a database of this gateway, of a newer version, locked by another gateway, or not writable.
    """

    def __init__(
        self,
        path: Path,
        boot: str,
        clock: Clock,
        *,
        commit_s: float = 20.0,
        retention: Retention = _RETENTION,
        retry_s: float = WriterTiming.retry_s,
        look_s: float = WriterTiming.look_s,
        hangs_after_s: float = WriterTiming.hangs_after_s,
        silent_s: float = WriterTiming.silent_s,
        origin: str = "",
    ) -> None:
        self._boot, self._clock, self._origin = boot, clock, origin
        self._pruning = Pruning(retention, clock.monotonic())
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise StoreError(f"{path}: cannot be written: {error.strerror}") from error
        path = link_followed(path)
        self._lock = FileLock(path)
        self._path, self._known, mended = path, Known(), NOTHING
        self.migrated_from: Path | None = None
        """Backup of the database of an earlier schema version, which was migrated now."""
        try:
            try:
                check_left(path)
                check_emptied(path)
                self._open()
            except (DamagedError, *UNREADABLE) as error:
                if not (isinstance(error, DamagedError) or is_damage(error)):
                    raise
                with long_work():
                    mended = self._mend(text_of(error))
                self._open()
        except UNREADABLE as error:
            self._lock.release()
            raise unusable(path, error) from error
        except BaseException:
            self._lock.release()
            raise
        timing = WriterTiming(
            commit_s=commit_s,
            retry_s=retry_s,
            look_s=look_s,
            hangs_after_s=hangs_after_s,
            silent_s=silent_s,
        )
        self._writer = DatabaseWriter(
            path, timing, self._prune, self._mark, self._mend_and_number, mended, self._keep_outside
        )

    def _open(self) -> None:
        self.migrated_from = make_schema(self._path) or self.migrated_from
        with closing(connect(self._path)) as connection:
            self._number = _next_boot(connection)
            earlier = _latest_boot(connection)
            here = connection.execute("SELECT run, origin FROM computer").fetchone() == (earlier, self._origin)
            self._predecessor = earlier if here and self._origin else None
            _remove_torn_step(connection)
            begin_epoch(connection)
            connection.commit()
            reference = connection.execute(rows.REFERENCE).fetchone()
            standing = {name: connection.execute(query).fetchone() for name, query in rows.STANDING.items()}
            self._channels = Channels(connection.execute("SELECT id, name, unit FROM channel").fetchall())
        self._known.standing = {name: row for name, row in standing.items() if row is not None}
        self._known.reference = None if reference is None else reference[1:]

    def same_file(self) -> AbstractContextManager[int]:
        """Inside, the file at the path stays the same, also when it is damaged; gives its number for `repair`."""
        return self._writer.same_file()

    def repair(self, error: Exception, file: int) -> None:
        """After `error` while a file was read: set it aside and go on with what can be read.

        Raises StoreError when that fails, or when the file cannot be read although nothing is damaged; another error is
        raised again.
        """
        try:
            damaged = is_damage(error) or unreadable_rows(self._path) > 0
        except UNREADABLE:
            damaged = True
        if not damaged:
            raise unusable(self._path, error) if isinstance(error, UNREADABLE) else error
        self._writer.mend(text_of(error), file)

    def __enter__(self) -> Self:
        self._writer.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._writer.close():
            self._lock.release()
        self._writer.check()

    def leave(self) -> None:
        """Release the lock of a store that was opened and is not used."""
        self._lock.release()

    @property
    def predecessor(self) -> str | None:
        """The name of the run before this one, if it ran on this computer since the computer was switched on: then it
        has ended.

        None: there was none, or it may be at work. In a copy of the database, the run before this one may be another
        computer's.
        """
        return self._predecessor

    @property
    def health(self) -> StoreHealth:
        """The state of storing; may be called from another thread."""
        return self._writer.health

    def flush(self) -> None:
        """Return when everything received so far is committed. Raises StoreError."""
        self._writer.flush()

    async def on_disk(self, limit_s: float = _ON_DISK_WITHIN_S) -> None:
        """Return when every number, frame, decision and measurement received so far is committed.

        The event loop runs meanwhile, and with it the heartbeat to the control. Raises StoreError if storing fails or
        takes longer than `limit_s`, real seconds.
        """
        await asyncio.to_thread(self._writer.flush, (WaitingKind.KEPT,), limit_s)

    def begin(self, config: str, fingerprint: str, versions: str, prior: tuple[str, str] | None = None) -> None:
        """Record what runs: configuration text and hash, relevant versions, hash and text of a prior."""
        if prior is not None:
            self._writer.put("prior", "INSERT OR IGNORE INTO prior VALUES (?, ?)", [prior])
            self._writer.put(
                "prior_of_boot", "INSERT OR IGNORE INTO prior_of_boot VALUES (?, ?)", [(self._number, prior[0])]
            )
        row = self._number, self._boot, self._clock.utc().isoformat(), config, fingerprint, versions
        self._known.boot = row
        self._writer.put("computer", "INSERT OR REPLACE INTO computer VALUES (0, ?, ?)", [(self._boot, self._origin)])
        self._writer.put("boot", "INSERT OR IGNORE INTO boot VALUES (?, ?, ?, ?, ?, ?)", [row], commit=True)

    def record(self, event: GatewayEvent) -> None:  # noqa: C901 - one arm for each kind of event
        """A gateway.model.events.Sink. What cannot be stored at once waits."""
        put = self._writer.put
        match event:
            case ConfigurationApplied(config):
                ran = (self._number, self._clock.utc().isoformat(), config.canonical(), config.fingerprint())
                put("running", "INSERT INTO running VALUES (NULL, ?, ?, ?, ?)", [ran], commit=True)
            case ReadingsTaken(readings):
                if new := self._channels.new(readings):
                    put("channel", _CHANNEL, new)
                put(
                    "reading",
                    "INSERT OR IGNORE INTO reading VALUES (?, ?, ?, ?, ?)",
                    self._channels.readings(self._number, readings),
                    kind=WaitingKind.READINGS,
                )
            case FrameMade(frame, moment):
                if self._known.first_k is None:
                    self._known.first_k = frame.k
                put("frame", "INSERT INTO frame VALUES (?, ?, ?, ?, ?, ?)", [rows.of_frame(self._boot, frame)])
                if frame.pause_unknown:
                    origin = "" if moment is None else moment.origin
                    begin = "coalesce((SELECT known FROM moment), 1)"
                    put("pause", f"INSERT INTO pause VALUES (?, ?, {begin}, 0)", [(frame.k, origin)])
                if moment is not None:
                    put("moment", "INSERT OR REPLACE INTO moment VALUES (0, ?, ?, ?, ?, ?)", [rows.of_moment(moment)])
                    if moment.known:  # the indices now cover the pause before this start of the computer
                        put(
                            "pause",
                            "UPDATE pause SET known = 1 WHERE origin = ? AND begin_known AND NOT known",
                            [(moment.origin,)],
                        )
            case DecisionMade(decision):
                self._put_codes(rows.of_codes(map(worded, decision.events)))
                put("trust", "INSERT OR REPLACE INTO trust VALUES (?, ?)", [rows.of_trust(decision)])
                put(
                    "decision",
                    "INSERT INTO decision VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)",
                    [rows.of_decision(decision)],
                    commit=True,
                )
            case ProbingRequested(number):
                put("request", "DELETE FROM request", [()])  # only the last one matters
                put(
                    "request",
                    "INSERT INTO request VALUES (?, ?)",
                    [(number, self._clock.utc().isoformat())],
                    commit=True,
                )
            case MeasurementEnded(outcome):
                self._put_codes(rows.of_texts(outcome.reason))
                row = rows.of_outcome(outcome)
                measured = outcome.measurement is not None and outcome.centres_mm is not None
                if outcome.why is Why.REFERENCE or (measured and self._known.reference is None):
                    self._known.reference = row
                put(
                    "measurement",
                    "INSERT INTO measurement VALUES (NULL, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
                    [row],
                    commit=True,
                )
            case ModelsAdopted(models, after_k):
                put("model", "INSERT INTO model VALUES (NULL, ?, ?, ?)", [rows.of_models(models, after_k)], commit=True)
            case EventReported(reported, k):
                reported = worded(reported)
                self._put_codes(rows.of_codes([reported]))
                row = rows.of_event(reported, k, self._clock.utc())
                put("event", "INSERT INTO event VALUES (NULL, ?, ?, ?, ?, ?, ?, ?)", [row], kind=WaitingKind.EVENTS)
            case CommandGiven(outcome):
                self._put_codes(rows.of_texts(outcome.text))
                row = rows.of_command(outcome)
                name = outcome.command.name
                if outcome.accepted and name in rows.STANDING:
                    self._known.standing.setdefault(name, row)
                elif outcome.accepted and name in rows.ENDS:
                    self._known.standing.pop(rows.ENDS[name], None)
                put("command", "INSERT INTO command VALUES (NULL, ?, ?, ?, ?, ?)", [row], commit=True)
            case CompensationStepped(write):
                row = rows.of_write(write)
                put(
                    "compensation",
                    "INSERT INTO compensation VALUES (NULL, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
                    [row],
                    kind=WaitingKind.STEPS,
                )
            case ReasonsGiven(reasons):
                row = (reasons.k, self._clock.utc().timestamp(), rows.of_reasons(reasons))
                put("reasons", "INSERT OR REPLACE INTO reasons VALUES (?, ?, ?)", [row], kind=WaitingKind.STEPS)
            case ForecastMade():
                pass  # later decisions show its outcome
            case Configured():
                pass  # the gateway's own is a ConfigurationApplied
            case OutlookChanged() | SensorsJudged() | StorageChanged() | HealthChecked():
                pass  # what an operator should know about them is also an EventReported
            case _:
                assert_never(event)

    def _put_codes(self, coded: Sequence[rows.Row]) -> None:
        """Store what texts say besides their words; those of which it is stored already change nothing."""
        if coded:
            statement = "INSERT OR IGNORE INTO coded VALUES (NULL, ?, ?, ?)"
            self._writer.put("coded", statement, coded, kind=WaitingKind.EVENTS)

    def keep(self, snapshot: Snapshot) -> None:
        """Store a snapshot, after the step that it was taken at, in the place of the older one of two. Returns at once.

        It is turned into bytes in the writer's thread.
        """
        slot = "coalesce((SELECT 1 - slot FROM snapshot ORDER BY k DESC LIMIT 1), 0)"
        row = snapshot.k, self._clock.utc().isoformat(), snapshot
        statement = f"INSERT OR REPLACE INTO snapshot VALUES ({slot}, ?, ?, zeroblob(?))"
        self._writer.put("snapshot", statement, [row], kind=WaitingKind.SNAPSHOTS)

    def _keep_outside(self, snapshot: Snapshot) -> None:
        """Called in the writer's thread. What is wrong with the disk shows in the database."""
        if self._known.boot is None:
            return
        config, first = stored_configuration(str(self._known.boot[3])), None
        if self._known.reference is not None:
            first = rows.reference_of(self._known.reference)
        with suppress(OSError):
            write_outside(
                self._path, Learnt(config.machine.name, config.talc.method, config.grid.step_s, snapshot.state, first)
            )

    def _mend(self, why: str) -> Text:
        return mend(self._path, why, self._clock.utc(), self._known)

    def _mend_and_number(self, why: str) -> Text:
        """While it runs: the channels keep their numbers."""
        self._writer.put("channel", _CHANNEL, self._channels.rows())
        return self._mend(why) if self._path.exists() else begin_again(self._path, self._known)

    def _mark(self, connection: sqlite3.Connection) -> None:
        self._pruning.mark(connection, self._clock.monotonic())

    def _prune(self, connection: sqlite3.Connection) -> None:
        self._pruning.prune(connection, self._clock.monotonic())


def _next_boot(connection: sqlite3.Connection) -> int:
    """Number of this run in this file: readings contain it instead of the long boot id."""
    (last,) = connection.execute("SELECT coalesce(max(number), 0) FROM boot").fetchone()
    with_readings = last_boot(connection)
    if not (isinstance(last, int) and isinstance(with_readings, int) and max(last, with_readings) < MOST_BOOTS):
        raise DamagedError("the stored number of a run is not an integer in the valid range")
    return max(last, with_readings) + 1


def _latest_boot(connection: sqlite3.Connection) -> str | None:
    row = connection.execute("SELECT id FROM boot ORDER BY number DESC LIMIT 1").fetchone()
    return None if row is None else str(row[0])


def _remove_torn_step(connection: sqlite3.Connection) -> None:
    """Remove what follows the last whole step: a frame without a decision counts as not made."""
    whole = connection.execute("SELECT f.k FROM frame f JOIN decision d ON d.k = f.k ORDER BY f.k DESC LIMIT 1")
    (last,) = whole.fetchone() or (-1,)
    for table in ("frame", "decision", "trust", "moment", "pause"):
        connection.execute(f"DELETE FROM {table} WHERE k > ?", (last,))
    for table in ("frame", "decision"):
        (left,) = connection.execute(f"SELECT coalesce(max(k), -1) FROM {table}").fetchone()
        if left != last:  # a damaged page: nothing is committed
            raise DamagedError(f"the last {table} is {left}, the last whole step {last}")
    connection.commit()


def boot_id() -> str:
    """A name for this run of the process, from the kernel."""
    return Path("/proc/sys/kernel/random/uuid").read_text(encoding="ascii").strip()
