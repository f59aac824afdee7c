"""Scans CAN buses: listens first, then asks every node by SDO for its identity."""

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass, replace

from drivers.base import BadAnswer, NoAnswer
from drivers.can.survey import CanSurvey, Heard, Stopped
from drivers.canopen.bus import CanOpenBus
from drivers.canopen.settings import CanOpenSettings
from drivers.recognition import Recognition, recognise_canopen
from gateway.commissioning.scan.found import Found, Place, ScanProgress, ScanReport, open_bus, read_inputs
from gateway.runtime.boundary import UnexpectedError, contained

_MOST_FRAMES = 8
"""How many identifiers of plain CAN are listed."""


@dataclass(frozen=True, slots=True)
class CanScan:
    """Where and how to scan."""

    settings: CanOpenSettings
    bitrates: tuple[int, ...]
    """Only slcan can have several: on other interfaces the system sets the rate."""
    nodes: Sequence[int]
    listen_s: float
    wait_s: float
    """How long the last node may take to answer."""
    anyway: bool = False
    """Also send at bit rates at which nothing was heard, if several are to be tried."""

    @property
    def intro(self) -> str:
        """What is done, for people."""
        by_system = self.settings.interface == "socketcan"
        rate = "bit rate set by the system" if by_system else f"bit rates {', '.join(map(str, self.bitrates))}"
        place = f"{self.settings.interface} {self.settings.channel}"
        return f"{place}: listening, then asking {len(self.nodes)} nodes ({rate})"

    @property
    def asking_s(self) -> float:
        """The longest duration for one bit rate."""
        slowest = min(self.bitrates)
        return len(self.nodes) * (400 / slowest + 0.004) + self.wait_s

    @property
    def longest_s(self) -> float:
        return len(self.bitrates) * (self.listen_s + self.asking_s)


async def scan_can(scan: CanScan, progress: ScanProgress, stopped: Stopped) -> ScanReport:
    """Listen at each bit rate, then ask the nodes at the one where something was heard.

    If nothing was heard and there are several rates, the report contains a question and no node was asked: a wrong rate
    disturbs nodes that use another. Raises DriverError.
    """
    report = ScanReport(total=2 * len(scan.bitrates))
    heard = {rate: Heard() for rate in scan.bitrates}
    for rate in scan.bitrates:
        if stopped():
            return report
        progress(report.asked, f"listening at {rate} bit/s")
        await contained(asyncio.to_thread(_listen, scan, rate, heard[rate], stopped), "listening")
        report.asked += 1
        if heard[rate].frames:
            break
    talking = [rate for rate in scan.bitrates if heard[rate].frames]
    rates = talking or list(scan.bitrates)
    if len(rates) > 1 and not scan.anyway:
        report.question = (
            "Nothing was received at any bit rate. Ask the nodes at each? "
            "At a wrong rate this disturbs nodes that use another."
        )
        report.remarks.append("nothing was received, and no node was asked")
        return report
    for rate in rates:
        if stopped():
            break
        progress(report.asked, f"asking nodes at {rate} bit/s")
        await contained(asyncio.to_thread(_ask, scan, rate, heard[rate], stopped), "asking nodes")
        report.asked += 1
        if heard[rate].nodes or talking:
            await _look(scan, rate, heard[rate], report, progress, stopped)
            break
    else:
        _note_silence(scan, heard, report)
    if not stopped():
        report.asked = report.total
    return report


def _at(scan: CanScan, rate: int) -> CanOpenSettings:
    return scan.settings.model_copy(update={"bitrate": rate})


def _listen(scan: CanScan, rate: int, heard: Heard, stopped: Stopped) -> None:
    with CanSurvey("scan", _at(scan, rate), listen_only=True) as survey:
        survey.listen(scan.listen_s, heard, stopped)


def _ask(scan: CanScan, rate: int, heard: Heard, stopped: Stopped) -> None:
    with CanSurvey("scan", _at(scan, rate)) as survey:
        survey.ask(scan.nodes, scan.wait_s, heard, stopped)


async def _look(
    scan: CanScan, rate: int, heard: Heard, report: ScanReport, progress: ScanProgress, stopped: Stopped
) -> None:
    """The identity of each node that answered."""
    settings = _at(scan, rate)
    bus = CanOpenBus("scan", settings.model_copy(update={"timeout_s": max(scan.wait_s, 0.1)}))
    found: list[Found] = []
    async with open_bus(bus):
        for node in heard.nodes:
            if stopped():
                break
            progress(report.asked, f"looking at node {node}")
            what = await _recognise(bus, node, heard, report)
            if what is not None:
                found.append(Found(node, what, await read_inputs(bus, node, what)))
    for node, code in heard.emergencies.items():
        report.remarks.append(f"node {node} sent an emergency: error code 0x{code:04X}")
    for node in sorted(heard.doubled):
        report.remarks.append(f"node {node} answered twice: two nodes have this id; give one of them another")
    _note_others(heard, report)
    if heard.error_frames:
        report.remarks.append(
            f"{heard.error_frames} error frames: a node with another bit rate, missing termination, or wiring"
        )
    options: dict[str, object] = {"interface": settings.interface, "channel": settings.channel, "bitrate": rate}
    if settings.interface == "udp_multicast":
        options["port"] = settings.port
    if found:
        report.places.append(Place("canopen", options, tuple(found)))


async def _recognise(bus: CanOpenBus, node: int, heard: Heard, report: ScanReport) -> Recognition | None:
    state = heard.states.get(node)
    if node not in heard.device_types:
        report.remarks.append(
            f"node {node} sends ({state or 'emergency'}) but does not answer SDO: is it stopped (NMT)?"
        )
        return None
    try:
        what = await contained(recognise_canopen(bus, node), f"the recognition of node {node}")
    except (NoAnswer, BadAnswer, UnexpectedError) as error:
        report.remarks.append(error.what)
        return None
    if what is not None and state is not None:
        return replace(what, evidence=f"{what.evidence}, {state}")
    return what


def _note_others(heard: Heard, report: ScanReport) -> None:
    others = heard.unexplained()
    for (identifier, extended), count in list(others.items())[:_MOST_FRAMES]:
        kind = "29 bits" if extended else "11 bits"
        report.remarks.append(
            f"frame 0x{identifier:X} ({kind}), {count} times: plain CAN; the manufacturer's DBC file describes it"
        )
    if len(others) > _MOST_FRAMES:
        report.remarks.append(f"and {len(others) - _MOST_FRAMES} more identifiers")


def _note_silence(scan: CanScan, heard: dict[int, Heard], report: ScanReport) -> None:
    errors = sum(h.error_frames for h in heard.values())
    listed = ", ".join(map(str, scan.bitrates))
    report.remarks.append(
        f"nothing was received at {listed} bit/s"
        + (f", {errors} error frames came" if errors else "")
        + ": check bit rate, termination (60 ohm between CAN_H and CAN_L), CAN_H and CAN_L swapped, power of the nodes"
    )
