"""`talc-gateway play`: puts a recording's devices on wires of this computer, with a configuration that reads them."""

import asyncio
import fcntl
import os
import struct
from collections.abc import AsyncIterator, Iterable, Iterator, Sequence
from contextlib import AsyncExitStack, asynccontextmanager, contextmanager, suppress
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Protocol

import can

from drivers.bounded_file import opened
from drivers.build import BUS_KINDS
from drivers.bus_settings import BusWire, Here
from drivers.can.settings import is_multicast_group
from gateway.acquisition.wire_log import MOST_EVENTS, WireEvent, WireLogError, is_wire_log, read_wire_log
from gateway.config.model import GatewayConfig
from gateway.config.packed import unpacked
from gateway.config.polled import BusSection
from gateway.config.wires import toml_value, wires_toml
from gateway.model.codes import NoticeCode
from gateway.model.text import Text
from gateway.runtime.bounded_memory import memory_for
from gateway.runtime.signals import stop_on_signals
from gateway.runtime.terminal import terminal
from gateway.runtime.whole_file import write_whole
from simulators.devices import (
    EXTENDED,
    Passed,
    PlayedAdapter,
    PlayedBroker,
    PlayedGroup,
    PlayedHost,
    PlayedLine,
    Script,
    can_script,
    stream_script,
    unnumbered,
)

_CAN_LOGS = (".asc", ".blf", ".csv", ".log", ".trc")
"""Formats of other programs that python-can reads; .log is candump's."""
_NOBODY = 1
"""A TCP port at which nobody listens."""


class _Stop(Protocol):
    async def stop(self) -> None: ...


@dataclass(frozen=True, slots=True)
class Played:
    """One bus that is being played."""

    bus: str
    kind: str
    place: dict[str, object]
    """Fields of its `[[bus]]` that say where it can be reached now; None: the field's default."""
    script: Script
    stops: _Stop


async def play_bus(
    bus: str, kind: str, events: Sequence[WireEvent], folder: Path, group: tuple[str, int] | None = None
) -> Played:
    """Put one bus of a recording on a wire: serial lines and CAN adapters get a link named after it in `folder`.

    group: address and port of a UDP multicast group that is the CAN bus, instead of an adapter

    Raises WireLogError for a kind of bus that cannot be played.
    """
    settings = BUS_KINDS.get(kind)
    if settings is None or settings.wire is None:
        raise WireLogError(f"bus {bus}: a bus of kind {kind} cannot be played")
    passed, link = list(_passed(events, settings.wire)), folder / bus
    match settings.wire:
        case "serial":
            script = stream_script(passed)
            script.is_rtu = settings.framing == "rtu"
            line = PlayedLine(script)
            return Played(bus, kind, settings.moved(Here(_link(link, await line.start()), _NOBODY)), script, line)
        case "tcp":
            numbered = settings.framing == "numbered"
            script = stream_script(unnumbered(passed) if numbered else passed)
            script.is_rtu = settings.framing == "rtu"
            host = PlayedHost(script, numbered=numbered)
            return Played(bus, kind, settings.moved(Here(str(link), await host.start())), script, host)
        case "mqtt":
            first_s, last_s = (events[0].at_s, events[-1].at_s) if events else (0.0, 0.0)
            script = replace(stream_script(passed), lasts_s=last_s - first_s)
            broker = PlayedBroker(script)
            return Played(bus, kind, settings.moved(Here(str(link), await broker.start())), script, broker)
        case "can":
            script = can_script(passed)
            if group is not None:
                address, port = group
                joined = PlayedGroup(script, address, port)
                await joined.start()
                there: dict[str, object] = {"interface": "udp_multicast", "channel": address, "port": port}
                return Played(bus, kind, there, script, joined)
            adapter = PlayedAdapter(script)
            there = settings.moved(Here(_link(link, await adapter.start()), _NOBODY))
            return Played(bus, kind, there, script, adapter)


def _passed(events: Iterable[WireEvent], wire: BusWire) -> Iterable[Passed]:
    """The events in the player's terms. The gateway's own actions on the connection are omitted."""
    for event in events:
        if event.passed == "note":
            if wire == "tcp" and event.lost:
                yield Passed(event.at_s, False, None)
        else:
            identifier = event.identifier
            if identifier is not None and event.extended:
                identifier |= EXTENDED
            yield Passed(event.at_s, event.passed == "sent", event.data, identifier)


def _link(link: Path, target: str) -> str:
    link.unlink(missing_ok=True)
    link.symlink_to(target)
    return str(link.absolute())


def multicast_group(text: str) -> tuple[str, int]:
    """Group and port of `GROUP:PORT`. Raises ValueError."""
    address, _, port = text.rpartition(":")
    if not port.isdecimal() or not 0 < int(port) < 65535 or not is_multicast_group(address):
        raise ValueError(f"{text}: expected GROUP:PORT, such as 239.74.163.2:43113")
    return address, int(port)


def play(path: Path, folder: Path, seconds: float | None, group: tuple[str, int] | None = None) -> None:
    """Play until Ctrl-C or for the given seconds.

    Raises WireLogError, ConfigError, or OSError if another `play` uses the folder.

    group: multicast group and port for CAN; a second CAN bus uses the next port
    """
    with _held(folder):
        with memory_for(path):
            config, events = read_wire_recording(path, folder)
        asyncio.run(_play(config, events, folder, seconds, group))


@contextmanager
def _held(folder: Path) -> Iterator[None]:
    """Makes the folder and keeps other players out of it: its links and its configuration belong to one."""
    absent = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise OSError(f"{folder}: another `play` uses this folder; stop it, or give another --folder") from None
        yield
    finally:
        os.close(descriptor)
        if absent:
            with suppress(OSError):  # not empty: it was used
                folder.rmdir()


async def _play(
    config: GatewayConfig | None,
    events: Sequence[WireEvent],
    folder: Path,
    seconds: float | None,
    group: tuple[str, int] | None,
) -> None:
    stop = asyncio.Event()
    stop_on_signals(stop)
    async with playing(config, events, folder, group):
        with suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                await stop.wait()


@asynccontextmanager
async def playing(
    config: GatewayConfig | None,
    events: Sequence[WireEvent],
    folder: Path,
    group: tuple[str, int] | None = None,
) -> AsyncIterator[None]:
    """All buses of a recording on wires of this computer, and in `folder` the configuration that reads them.

    config, events: see `read_wire_recording`. group: see `play`. Raises WireLogError, ConfigError, or OSError.
    """
    console = terminal()
    kinds = _kinds(config, events)
    never = [] if config is None else [bus.name for bus in config.buses if bus.unrecorded]
    played = list[Played]()
    async with AsyncExitStack() as stack:
        for bus, kind in kinds.items():
            of_bus = [event for event in events if event.bus == bus]
            if not of_bus:
                why = "is never recorded" if bus in never else "did not open while recording"
                console.print(f"{bus} ({kind}): {why}, so it is absent now", highlight=False)
                continue
            one = await play_bus(bus, kind, of_bus, folder, group)
            if group is not None and BUS_KINDS[kind].wire == "can":
                group = group[0], group[1] + 1
            stack.push_async_callback(one.stops.stop)
            played.append(one)
        for one in played:
            asked = len(one.script.answers)
            console.print(
                f"{one.bus} ({one.kind}): {asked} different requests, {len(one.script.unasked)} messages unasked",
                highlight=False, soft_wrap=True,
            )  # fmt: skip
        console.print(_ready(config, played, folder), highlight=False, soft_wrap=True)
        yield
    for one in played:
        (folder / one.bus).unlink(missing_ok=True)  # links of serial lines and adapters
        if one.script.unknown:
            console.print(f"{one.bus}: {one.script.unknown} requests were not in the recording", style="yellow")


def _ready(config: GatewayConfig | None, played: Sequence[Played], folder: Path) -> str:
    """Writes the configuration, and returns how to continue."""
    if config is None:
        sections = ["[[bus]]", *(f"{k} = {toml_value(v)}" for one in played for k, v in _fields(one).items())]
        return "to read it:\n" + "\n".join(sections)
    file = folder / "gateway.toml"
    places = {bus.name: _nowhere(bus, folder) for bus in config.buses} | {one.bus: one.place for one in played}
    write_whole(file, wires_toml(config, places))  # whole whenever it is there: scripts wait for it
    return f"ready: talc-gateway probe {file}; Ctrl-C stops"


def _nowhere(bus: BusSection, folder: Path) -> dict[str, object]:
    """An address at which a bus that never opened cannot be opened either."""
    return bus.moved(Here(str((folder / bus.name).absolute()), _NOBODY))


def _fields(one: Played) -> dict[str, object]:
    place = {field: value for field, value in one.place.items() if value is not None}
    return {"name": one.bus, "kind": one.kind, **place}


def read_wire_recording(path: Path, folder: Path) -> tuple[GatewayConfig | None, Sequence[WireEvent]]:
    """The configuration (None for another program's file, which has none), and the recorded events.

    folder: user profiles in the recording are written to its sub-folder `profiles`

    Raises WireLogError, ConfigError, or OSError.
    """
    if is_wire_log(path) or path.suffix.lower() not in _CAN_LOGS:
        log = read_wire_log(path)
        return unpacked(log.config, path, folder), log.events
    try:
        opened(path).close()
        with can.LogReader(path) as messages:
            found = (_event(m) for m in messages if not (m.is_error_frame or m.is_remote_frame))
            events = list(islice(found, MOST_EVENTS + 1))
    except (ValueError, OSError, IndexError, KeyError, struct.error, can.CanError) as error:
        raise WireLogError(f"{path}: cannot be read as a CAN log: {error}") from error
    if len(events) > MOST_EVENTS:
        raise WireLogError(Text(NoticeCode.WIRE_LOG_LONG, path=str(path), most=MOST_EVENTS))
    if not events:
        raise WireLogError(f"{path}: contains no CAN frames")
    return None, events


def _event(message: can.Message) -> WireEvent:
    return WireEvent(
        message.timestamp, "can1", "received" if message.is_rx else "sent", bytes(message.data), message.arbitration_id,
        message.is_extended_id,
    )  # fmt: skip


def _kinds(config: GatewayConfig | None, events: Sequence[WireEvent]) -> dict[str, str]:
    """Bus to its kind. A CAN log of another program counts as CANopen if it contains an SDO request."""
    if config is not None:
        return {bus.name: bus.kind for bus in config.buses}
    asked = any(event.passed == "sent" for event in events)
    return {"can1": "canopen" if asked else "can"}
