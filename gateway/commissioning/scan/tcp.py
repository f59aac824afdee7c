"""Scans hosts that the user names: Modbus TCP units behind them, or a Micro-Epsilon controller's data port."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

from drivers.base import BadAnswer, ConnectError, NoAnswer, Refused
from drivers.bus_settings import HostSettings
from drivers.can.survey import Stopped
from drivers.micro_epsilon.ethernet import MeEthernetBus
from drivers.micro_epsilon.settings import MeEthernetSettings
from drivers.modbus.bus import ModbusBus, ModbusTcpBus
from drivers.modbus.numbers import Block
from drivers.modbus.rtu import ModbusRtuTcpBus
from drivers.modbus.settings import ModbusRtuTcpSettings, ModbusTcpSettings
from drivers.problems import read_settings
from drivers.recognition import Recognition, recognise_me_ethernet, recognise_modbus
from drivers.section import host_and_port, host_name
from drivers.text import shown
from gateway.commissioning.scan.alike import UNUSUAL_UNITS, told_apart
from gateway.commissioning.scan.found import Found, Place, ScanProgress, ScanReport, open_bus, read_inputs
from gateway.commissioning.scan.serial import ANY_REGISTER
from gateway.model.codes import NoticeCode
from gateway.model.text import Text
from gateway.runtime.boundary import UnexpectedError, contained

_MOST_ODD = 3
"""Units with invalid answers before the scan leaves the host."""
_ANY = (ANY_REGISTER, Block(4, 0, 1), Block(2, 0, 1), Block(1, 0, 1))
_VALUE = "a value"

H = TypeVar("H", bound=HostSettings)


def scanned_host(text: str) -> tuple[str, int | None]:
    """Host, and port if it has one, of `host` or `host:port`. Raises ValueError."""
    host, colon, port = text.rpartition(":") if text.count(":") == 1 else (text, "", "")
    if colon and not (port.isdecimal() and len(port) <= 5 and 0 < int(port) < 65536):
        raise ValueError(Text("a_port", value=shown(text)))
    try:
        host_name(host)
    except ValueError:
        raise ValueError(Text(NoticeCode.SCAN_HOST, value=shown(text))) from None
    return host, int(port) if colon else None


@dataclass(frozen=True, slots=True)
class TcpScan:
    """Which hosts, ports and units to ask."""

    hosts: tuple[tuple[str, int | None], ...]
    """Host and port; None: the usual ports of Modbus and of controllers. A given port is tried for both."""
    units: Sequence[int]
    timeout_s: float
    rtu: bool = False
    """Ask with RTU frames, as behind a device server, instead of Modbus TCP. Every port must be given."""

    @property
    def requests(self) -> int:
        return len(self.hosts) * (len(self.units) + 2)

    @property
    def intro(self) -> str:
        """What is asked, for people."""
        listed = ", ".join(host if port is None else host_and_port(host, port) for host, port in self.hosts)
        return f"{listed}: {self.requests} requests"

    @property
    def longest_s(self) -> float:
        """The longest duration if nothing answers."""
        return self.requests * self.timeout_s


async def scan_hosts(scan: TcpScan, progress: ScanProgress, stopped: Stopped) -> ScanReport:
    """Ask until done or stopped. A host that does not answer is a remark, not an error.

    Raises SetupError, before anything is asked, for a host, port or timeout with which no bus could be.
    """
    report = ScanReport(total=scan.requests)
    modbus: type[ModbusRtuTcpSettings | ModbusTcpSettings] = ModbusRtuTcpSettings if scan.rtu else ModbusTcpSettings
    places = [(_at(scan, modbus, *where), _at(scan, MeEthernetSettings, *where)) for where in scan.hosts]
    for number, ((_, port), (units, controller)) in enumerate(zip(scan.hosts, places, strict=True), start=1):
        before = len(report.places)
        doubts = await _modbus(scan, units, report, progress, stopped)
        ended = stopped()
        if not ended and (port is None or (len(report.places) == before and not scan.rtu)):
            progress(report.asked, controller.place)
            doubts += await _controller(controller, report)
        if len(report.places) == before:  # else errors of the other protocol need no remark
            report.remarks += doubts
        if ended:
            break
        report.asked = number * (len(scan.units) + 2)
    return report


def _at(scan: TcpScan, kind: type[H], host: str, port: int | None) -> H:
    """Without a port, the usual one of this kind."""
    given: dict[str, object] = {"host": host, "timeout_s": scan.timeout_s}
    return read_settings(kind, given if port is None else {**given, "port": port})


async def _modbus(
    scan: TcpScan,
    settings: ModbusRtuTcpSettings | ModbusTcpSettings,
    report: ScanReport,
    progress: ScanProgress,
    stopped: Stopped,
) -> list[str]:
    """Adds the units to the report; returns why there may be none."""
    place = settings.place
    bus = (
        ModbusRtuTcpBus("scan", settings)
        if isinstance(settings, ModbusRtuTcpSettings)
        else ModbusTcpBus("scan", settings)
    )
    found: list[Found] = []
    odd: list[str] = []
    doubts: list[str] = []
    try:
        async with open_bus(bus):
            unknown = await _answers(bus, next(unit for unit in UNUSUAL_UNITS if unit not in scan.units[:2]), [])
            as_unknown: list[int] = []
            for unit in scan.units:
                if stopped() or (len(odd) >= _MOST_ODD and not found and not as_unknown):
                    break
                progress(report.asked, f"{place} unit {unit}")
                report.asked += 1
                await contained(bus.connect(), "connect")  # some hosts close the connection on an unknown unit
                if not (answer := await _answers(bus, unit, odd)):
                    continue
                if answer == unknown:
                    as_unknown.append(unit)
                else:
                    found.append(await _look(bus, unit))
            found, remark = await _told_apart(bus, scan.units, found, as_unknown, unknown, stopped)
            report.remarks += [f"{place} {remark}"] if remark else []
            if not found and not stopped():
                nobody = "accepts connections, but none of the units that were asked answers (try --units 0-16,255)"
                doubts.append(f"Modbus: {odd[0]}" if odd else f"{place} {nobody}")
    except (ConnectError, UnexpectedError) as error:
        doubts.append(f"Modbus: {error.advice}")
    if found:
        report.places.append(Place(bus.kind, {"host": settings.host, "port": settings.port}, tuple(found)))
    return doubts


async def _told_apart(
    bus: ModbusBus,
    asked: Sequence[int],
    found: Sequence[Found],
    as_unknown: list[int],
    unknown: tuple[str, ...],
    stopped: Stopped,
) -> tuple[list[Found], str]:
    """Each device once, and a remark on the ids.

    as_unknown: ids that answer as unused ids do; if unused ids are answered with a value, every device answers so
    """
    remark = ""
    answering = sorted(device.unit for device in found)
    if unknown[-1:] == (_VALUE,):
        answering = sorted(answering + as_unknown)
    elif not answering and as_unknown:
        answering = as_unknown[:1]
        remark = (
            f"refuses every unit asked as it refuses unknown ones: one device, shown as unit {answering[0]}, or one "
            "with an id that was not asked (--units 1-247?)"
        )
    if answering and not remark and not stopped():
        answering, remark = await told_apart(bus, asked, answering)
    looked = {device.unit: device for device in found}
    return [looked.get(u) or await _look(bus, u) for u in answering if u in looked or not stopped()], remark


async def _answers(bus: ModbusBus, unit: int, odd: list[str]) -> tuple[str, ...]:
    """How the unit answers: its refusals up to the first value; empty: it does not. Invalid answers go to `odd`.

    Servers that refuse an unknown unit as they refuse an unknown address differ only in what they do not refuse.
    """
    told: list[str] = []
    for block in _ANY:
        try:
            await contained(bus.read("", unit, block), f"the request to unit {unit}")
        except NoAnswer:
            break
        except (BadAnswer, ConnectError, UnexpectedError) as error:
            if not told:
                odd.append(error.advice)
            break
        except Refused as error:
            told.append(error.reason)
        else:
            told.append(_VALUE)
            break
    return tuple(told)


async def _look(bus: ModbusBus, unit: int) -> Found:
    try:
        what = await contained(recognise_modbus(bus, unit), f"the recognition of unit {unit}")
        return Found(unit, what, await read_inputs(bus, unit, what))
    except ConnectError:
        return Found(unit, Recognition("", (), "answers, but closes the connection when asked for its identity"))
    except UnexpectedError as error:
        return Found(unit, Recognition("", (), f"answers, but cannot be recognised: {error.what}"))


async def _controller(settings: MeEthernetSettings, report: ScanReport) -> list[str]:
    """Adds the controller to the report; returns why there may be none."""
    bus = MeEthernetBus("scan", settings)
    try:
        async with open_bus(bus):
            what = await contained(recognise_me_ethernet(bus), "the recognition")
            reads = await read_inputs(bus, 1, what)
    except (ConnectError, NoAnswer, BadAnswer, UnexpectedError) as error:
        return [f"displacement controller: {error.what}"]
    options = {"host": settings.host, "port": settings.port}
    report.places.append(Place(settings.bus_kind, options, (Found(1, what, reads),)))
    return []
