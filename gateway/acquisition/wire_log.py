"""The wire log: the traffic on the wires, one line of text each; `docs/wire-log.md` describes the form, version 1.

CAN frames are lines of candump's log format, `(time) bus id#data R` or `T`; bytes of serial lines and TCP connections
are `(time) bus > hex` (sent by the gateway) or `<`; `!` is a note on the connection. Times are UTC
seconds that never jump.
"""

import logging
import re
import threading
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import count
from pathlib import Path
from queue import SimpleQueue
from time import monotonic
from types import TracebackType
from typing import Literal, Self, TextIO

from drivers.bounded_file import opened
from gateway.config.model import GatewayConfig
from gateway.model.codes import NoticeCode
from gateway.model.given import GivenError
from gateway.model.text import Text

log = logging.getLogger(__name__)

_FIRST_LINE = "# talc wire log 1"
_CONFIG = "#: "
_MOST_WAITING = 10_000
"""Lines that may wait for the disk: some seconds of a busy machine."""
_LONGEST_LINE = 2**24
"""Bytes; a line of the configuration may hold a DBC file."""
MOST_EVENTS = 5_000_000
"""That are read: a file of `--record` has fewer."""
_LINE = re.compile(r"\((\d+\.\d+)\) (\w+) (?:([<>]) ([0-9a-f]*)|! (.+)|([0-9A-F]{3}|[0-9A-F]{8})#([0-9A-F]*) ([RT]))")

PassedKind = Literal["sent", "received", "note"]


class WireLogError(GivenError):
    """The file is not a recording. The text names file and line."""


@dataclass(frozen=True, slots=True)
class WireEvent:
    """One message on the wire, or one event of the connection."""

    at_s: float
    """UTC, seconds since 1970."""
    bus: str
    passed: PassedKind
    data: bytes = b""
    identifier: int | None = None
    """Identifier of a CAN frame; None: bytes of a stream."""
    extended: bool = False
    note: str = ""

    @property
    def lost(self) -> bool:
        """Whether the connection was lost; the first word of a note says what became of it."""
        return self.note.partition(" ")[0] == "lost"


@dataclass(frozen=True, slots=True)
class WireLog:
    """A whole recording."""

    config: str
    """TOML: the buses and devices that were read."""
    events: tuple[WireEvent, ...]

    def of(self, bus: str) -> tuple[WireEvent, ...]:
        """The events of one bus, in order."""
        return tuple(event for event in self.events if event.bus == bus)


class WireLogWriter:
    """Writes a recording while buses are read; each bus passes its traffic to its `tap`, from any thread.

    A separate thread writes between enter and exit, so that a slow disk delays no bus; lines that it cannot take in
    time are counted in `dropped`. A full disk ends the recording and nothing else.

    Parameters
    ----------
    path: overwritten
    config: TOML of what is read
    began: now, aware
    most_bytes: at this size the recording ends
    rotate: or the file is renamed, `path` with .1 added, and another begins

    Raises OSError when the file cannot be made.
    """

    def __init__(self, path: Path, config: str, began: datetime, *, most_bytes: int, rotate: bool = False) -> None:
        self._path, self._config, self._most_bytes, self._rotate = path, config, most_bytes, rotate
        self._offset_s = began.timestamp() - monotonic()
        self.ended = ""
        """Why writing has ended."""
        self.counts: dict[str, int] = {}
        """Lines written, by bus."""
        self.dropped = 0
        self._waiting: SimpleQueue[tuple[str, str] | None] = SimpleQueue()
        self._thread = threading.Thread(target=self._work, name=f"wire log {path.name}")
        self._written = 0
        self._file: TextIO | None = None
        self._begin()

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._waiting.put(None)
        self._thread.join()

    def tap(self, bus: str) -> "BusTap":
        """The tap to which one bus passes its traffic."""
        self.counts.setdefault(bus, 0)
        return BusTap(self, bus)

    def line(self, bus: str, text: str) -> None:
        """One line, at the present time."""
        if self._waiting.qsize() < _MOST_WAITING:
            self._waiting.put((bus, f"({monotonic() + self._offset_s:.6f}) {bus} {text}\n"))
        else:
            self.dropped += 1

    def reconfigure(self, config: str) -> None:
        """Other buses or devices are read from now on: another file begins."""
        self._waiting.put(("", config))

    def _work(self) -> None:
        """Runs in the thread, until it receives None."""
        while (item := self._waiting.get()) is not None:
            bus, text = item
            if not bus:
                self._config = text
                self._next_file()
            elif self._put(text):
                self.counts[bus] += 1
            if self._file is not None and self._waiting.empty():
                self._guarded(self._file.flush)  # write out every line as soon as there is time: power may fail
        self._close()

    def _begin(self) -> None:
        self._file = self._path.open("w", encoding="utf-8")
        began = datetime.fromtimestamp(monotonic() + self._offset_s, UTC)
        header = f"{_FIRST_LINE}\n# began {began.isoformat(timespec='milliseconds')}\n"
        header += "".join(f"{_CONFIG}{line}\n" for line in self._config.removesuffix("\n").split("\n"))
        self._written = len(header)
        self._guarded(lambda: self._file and self._file.write(header))

    def _next_file(self) -> None:
        """Renames the full file; only one is kept."""
        self._close()

        def change() -> None:
            self._path.replace(self._path.with_name(self._path.name + ".1"))
            self._begin()

        self._guarded(change)

    def _put(self, text: str) -> bool:
        if self._file is None:
            return False
        if self._written + len(text) > self._most_bytes:
            if not self._rotate:
                self.ended = f"{self._path} has reached {self._most_bytes / 1e6:g} MB"
                self._close()
                return False
            self._next_file()
        file = self._file
        if file is not None:
            self._guarded(lambda: file.write(text))
            self._written += len(text)
        return self._file is not None

    def _guarded(self, work: Callable[[], object]) -> None:
        try:
            work()
        except OSError as error:
            self._end(error)
            self._close()

    def _end(self, error: OSError) -> None:
        if not self.ended:
            self.ended = f"{self._path}: {error.strerror or error}"
            log.warning("%s", Text(NoticeCode.RECORDING_ENDED, why=self.ended))

    def _close(self) -> None:
        file, self._file = self._file, None
        try:
            if file is not None:
                file.close()
        except OSError as error:
            self._end(error)


class BusTap:
    """Receives what passes on one bus and writes it to the file."""

    def __init__(self, writer: WireLogWriter, bus: str) -> None:
        self._writer, self._bus = writer, bus

    def data(self, sent: bool, data: bytes) -> None:
        """Bytes of a stream."""
        self._writer.line(self._bus, f"{'>' if sent else '<'} {data.hex()}")

    def frame(self, sent: bool, identifier: int, extended: bool, data: bytes) -> None:
        """A CAN frame."""
        self._writer.line(
            self._bus, f"{identifier:0{8 if extended else 3}X}#{data.hex().upper()} {'T' if sent else 'R'}"
        )

    def note(self, text: str) -> None:
        """What happened to the connection."""
        printable = "".join(c if c.isprintable() else " " for c in text)
        self._writer.line(self._bus, f"! {printable}")


def is_wire_log(path: Path) -> bool:
    """Whether the file begins like a recording. Raises OSError."""
    with opened(path) as file:
        return file.read(len(_FIRST_LINE)) == _FIRST_LINE.encode()


def read_wire_log(path: Path) -> WireLog:
    """A recording. A last line that was cut by a power failure is left out.

    Raises WireLogError naming the line, or OSError.
    """
    config: list[str] = []
    events: list[WireEvent] = []
    with opened(path) as file:
        if file.readline(_LONGEST_LINE).rstrip(b"\n") != _FIRST_LINE.encode():
            raise WireLogError(f"{path}: is not a recording: its first line is not {_FIRST_LINE!r}")
        for number in count(2):
            read = file.readline(_LONGEST_LINE)
            if len(read) == _LONGEST_LINE:
                raise WireLogError(Text(NoticeCode.WIRE_LOG_LINE, path=str(path), line=number))
            if not read.endswith(b"\n"):
                break
            line = read[:-1].decode("utf-8", "replace")
            if line.startswith(_CONFIG):
                config.append(line.removeprefix(_CONFIG))
            elif line and not line.startswith("#"):
                event = _event(line)
                if event is None:
                    raise WireLogError(f"{path}, line {number}: cannot be read: {line[:60]!r}")
                events.append(event)
            if len(events) > MOST_EVENTS:
                raise WireLogError(Text(NoticeCode.WIRE_LOG_LONG, path=str(path), most=MOST_EVENTS))
    return WireLog("\n".join(config), tuple(events))


def _event(line: str) -> WireEvent | None:
    found = _LINE.fullmatch(line)
    if found is None:
        return None
    at, bus, arrow, stream, note, identifier, frame, direction = found.groups()
    if note is not None:
        return WireEvent(float(at), bus, "note", note=note)
    digits = frame if identifier else stream
    if len(digits) % 2:
        return None
    passed: PassedKind = "sent" if arrow == ">" or direction == "T" else "received"
    if identifier is None:
        return WireEvent(float(at), bus, passed, bytes.fromhex(digits))
    return WireEvent(float(at), bus, passed, bytes.fromhex(digits), int(identifier, 16), len(identifier) == 8)


def not_recorded(config: GatewayConfig) -> list[str]:
    """The buses whose traffic the wire log does not hold, and what to do instead."""
    instead = "db export, or a Zenoh subscriber, keeps the values that were read"
    return [
        f"bus '{bus.name}' ({bus.kind}): the traffic of {bus.unrecorded} is not recorded; {instead}"
        for bus in config.buses
        if bus.unrecorded
    ]
