"""Scans serial lines: asks unit after unit, at each speed and parity to try."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

from drivers.base import BadAnswer, ConnectError, DriverError, NoAnswer
from drivers.bus_settings import Parity
from drivers.can.survey import Stopped
from drivers.micro_epsilon.rs485 import MeRs485Bus
from drivers.micro_epsilon.settings import MeRs485Settings
from drivers.modbus.numbers import Block
from drivers.modbus.rtu import ModbusRtuBus
from drivers.modbus.settings import ModbusRtuSettings
from drivers.problems import read_settings
from drivers.recognition import Recognition, recognise_me_rs485, recognise_modbus
from drivers.text import shown
from gateway.commissioning.scan.alike import told_apart
from gateway.commissioning.scan.found import Found, Place, ScanProgress, ScanReport, open_bus, read_inputs
from gateway.model.codes import NoticeCode
from gateway.model.text import Text
from gateway.runtime.boundary import UnexpectedError, contained

ANY_REGISTER = Block(3, 0, 1)
"""The request to every unit: nearly every device can read holding registers, and most others refuse, which is an answer
too."""
_ME_PARITIES: tuple[Parity, ...] = ("N", "E")
_MOST_BABBLE = 3
"""Number of units per speed with invalid answers that are shown."""
_ANY_SPEED = 3
"""Who answers alike at so many speeds, and at all that were tried, has no speed: a USB device, or an emulated one."""


@dataclass(frozen=True, slots=True)
class LineTry:
    """One protocol, speed and parity at which units are asked."""

    settings: ModbusRtuSettings | MeRs485Settings
    units: Sequence[int]

    @property
    def protocol(self) -> str:
        return self.settings.bus_kind

    @property
    def framing(self) -> str:
        return f"{self.settings.baud} 8{self.settings.parity}1"


@dataclass(frozen=True, slots=True)
class SerialScan:
    """Plan of a scan on one port."""

    tries: tuple[LineTry, ...]
    function: int = 3
    """Modbus function of the first question."""

    @property
    def requests(self) -> int:
        return sum(len(attempt.units) for attempt in self.tries)

    @property
    def intro(self) -> str:
        """What is asked, for people."""
        framings: dict[str, list[str]] = {}
        for attempt in self.tries:
            framings.setdefault(attempt.protocol, []).append(attempt.framing)
        listed = "; ".join(f"{protocol} at {', '.join(at)}" for protocol, at in framings.items())
        return f"{self.requests} requests ({listed})"

    @property
    def longest_s(self) -> float:
        """The longest duration if no unit answers; each one that does takes slightly longer."""
        return sum(len(t.units) * (t.settings.timeout_s + 0.003 + 40 / t.settings.baud) for t in self.tries)


def scanned_port(name: str) -> str:
    """The name of a serial port of this computer: a scan sets its speed. Raises ValueError."""
    if "://" in name:
        raise ValueError(Text(NoticeCode.SCAN_PORT_SERVER, value=shown(name)))
    if not Path(name).name or "\0" in name:
        raise ValueError(Text(NoticeCode.SCAN_PORT, value=shown(name)))
    return name


def plan(
    port: str,
    *,
    bauds: Sequence[int],
    parities: Sequence[Parity],
    units: Sequence[int],
    me_bauds: Sequence[int],
    me_addresses: Sequence[int],
    timeout_s: float,
    function: int = 3,
) -> SerialScan:
    """Modbus at every speed and parity, then Micro-Epsilon sensors likewise; an empty list omits that protocol.

    timeout_s: how long each unit may take to answer

    Raises SetupError naming the field and the value with which no bus could be.
    """

    def lines(bauds: Sequence[int], parities: Sequence[Parity]) -> Iterator[Mapping[str, object]]:
        for baud, parity in product(bauds, parities):
            yield {"port": port, "baud": baud, "parity": parity, "timeout_s": timeout_s}

    modbus = [LineTry(read_settings(ModbusRtuSettings, at), units) for at in lines(bauds, parities) if units]
    me = [
        LineTry(read_settings(MeRs485Settings, at), me_addresses)
        for at in lines(me_bauds, _ME_PARITIES)
        if me_addresses
    ]
    return SerialScan((*modbus, *me), function)


async def scan_line(scan: SerialScan, progress: ScanProgress, stopped: Stopped) -> ScanReport:
    """Ask until done or stopped. A request in progress is finished first, so no unit is left answering.

    Raises DriverError if the port cannot be opened at all.
    """
    report = ScanReport(total=scan.requests)
    refused: dict[str, list[str]] = {}
    first_refusal: DriverError | None = None
    tried = Counter[str]()
    for attempt in scan.tries:
        if stopped():
            break
        try:
            place = await _try(scan, attempt, report, progress, stopped)
        except (ConnectError, UnexpectedError) as error:
            first_refusal = first_refusal or error
            refused.setdefault(error.what, []).append(attempt.framing)
            report.asked += len(attempt.units)
            continue
        tried[attempt.protocol] += 1
        if place.devices:
            report.places.append(place)
    if first_refusal is not None and sum(map(len, refused.values())) == len(scan.tries):
        raise first_refusal
    report.remarks += [f"{', '.join(dict.fromkeys(at))} could not be tried: {what}" for what, at in refused.items()]
    for protocol, speeds in tried.items():
        _without_speed(report, protocol, speeds)
    return report


def _without_speed(report: ScanReport, protocol: str, speeds: int) -> None:
    """Keep one place of those at which the same devices have answered at every speed."""
    places = [place for place in report.places if place.kind == protocol]
    there = [[(device.unit, device.what) for device in place.devices] for place in places]
    if len(places) == speeds >= _ANY_SPEED and all(each == there[0] for each in there):
        report.places = [place for place in report.places if place not in places[1:]]
        report.remarks.append(f"{protocol}: the same at each of {speeds} speeds; shown at the first")


async def _try(
    scan: SerialScan, attempt: LineTry, report: ScanReport, progress: ScanProgress, stopped: Stopped
) -> Place:
    line = attempt.settings
    bus = ModbusRtuBus("scan", line) if isinstance(line, ModbusRtuSettings) else MeRs485Bus("scan", line)
    babble: list[str] = []
    found: list[Found] = []
    async with open_bus(bus):
        for unit in attempt.units:
            if stopped():
                break
            progress(report.asked, f"{attempt.protocol} {attempt.framing} unit {unit}")
            what = await _ask(bus, unit, Block(scan.function, 0, 1), babble)
            report.asked += 1
            if what is not None:
                found.append(Found(unit, what, await read_inputs(bus, unit, what)))
        if len(found) > 1 and isinstance(bus, ModbusRtuBus) and not stopped():
            kept, remark = await told_apart(bus, attempt.units, [device.unit for device in found])
            found = [device for device in found if device.unit in kept]
            report.remarks += [f"{attempt.framing}: {remark}"] if remark else []
    report.remarks += [f"{attempt.framing}: {text}" for text in babble[:_MOST_BABBLE]]
    if len(babble) > _MOST_BABBLE:
        report.remarks.append(f"{attempt.framing}: and the same from {len(babble) - _MOST_BABBLE} more")
    return Place(attempt.protocol, {"port": line.port, "baud": line.baud, "parity": line.parity}, tuple(found))


async def _ask(bus: ModbusRtuBus | MeRs485Bus, unit: int, question: Block, babble: list[str]) -> Recognition | None:
    """What the unit is, None if it is silent; invalid answers and unexpected errors are recorded in `babble`.

    Raises ConnectError.
    """
    try:
        if isinstance(bus, MeRs485Bus):
            return await contained(recognise_me_rs485(bus, unit), f"the request to unit {unit}")
        try:
            await contained(bus.read("", unit, question), f"the request to unit {unit}")
        except NoAnswer:
            return None
        except (BadAnswer, ConnectError, UnexpectedError):
            raise
        except DriverError:  # a refusal is an answer too
            pass
        return await contained(recognise_modbus(bus, unit), f"the recognition of unit {unit}")
    except (BadAnswer, UnexpectedError) as error:
        babble.append(error.advice)
        return None
