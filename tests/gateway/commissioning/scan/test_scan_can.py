"""Scanning a CAN bus through an emulated adapter: bit rates, nodes, and what is only heard."""

import asyncio
import re
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path

import can as python_can
import pytest
from canopen import Network

from drivers.can.survey import Heard
from drivers.canopen.settings import CanOpenSettings
from gateway.commissioning.scan.can import CanScan, scan_can
from gateway.commissioning.scan.found import ScanReport
from gateway.config.file import load
from simulators.devices import Cia404Node, SlcanAdapter
from simulators.devices.can_logger import CanLogger
from simulators.devices.cia404_node import Nmt
from simulators.devices.multicast_bus import MulticastBus
from simulators.devices.slcan_adapter import CanFrame, CanNode
from tests.benches.command import here, talc_gateway
from tests.benches.free_port import free_port

TEMPERATURES = [20.0, 21.5, -3.0, 40.0]


def node(node_id: int, vendor: str = "esd", heartbeat_ms: int = 0) -> Cia404Node:
    return Cia404Node(node_id, lambda: TEMPERATURES, inputs=4, vendor=vendor, heartbeat_ms=heartbeat_ms)


class Spy:
    """Notes every frame that is sent, and sends nothing."""

    def __init__(self) -> None:
        self.frames: list[CanFrame] = []

    def on_frame(self, identifier: int, data: bytes) -> Sequence[CanFrame]:
        self.frames.append((identifier, data))
        return ()


@asynccontextmanager
async def bus(nodes: Sequence[CanNode], bitrate: int = 125_000) -> AsyncIterator[tuple[SlcanAdapter, CanScan]]:
    adapter = SlcanAdapter(nodes, bitrate=bitrate)
    path = await adapter.start()
    settings = CanOpenSettings(interface="slcan", channel=path)
    try:
        yield adapter, CanScan(settings, (125_000,), range(1, 128), listen_s=0.1, wait_s=0.3)
    finally:
        await adapter.stop()


async def scan(what: CanScan) -> ScanReport:
    return await scan_can(what, lambda *_: None, lambda: False)


@pytest.mark.slow
@pytest.mark.simulated_time
async def test_nodes_are_recognised_by_profile_vendor_and_inputs() -> None:
    odd = node(9, "jumo")
    odd.set_sensor_type(1, 1)  # a thermocouple
    async with bus([node(5), odd, node(127, "axiomatic")]) as (_, what):
        report = await scan(what)
    found = {device.unit: device for device in report.found}
    assert {unit: device.what.profile for unit, device in found.items()} == dict.fromkeys((5, 9, 127), "cia404")
    assert found[5].what.options == {"vendor": "esd"}
    assert found[5].what.evidence == "device profile 404, vendor 0x17 product 0x194 serial 4711"
    assert found[5].reads == "20.00 21.50 -3.00 40.00 degC"
    assert found[127].what.options == {"vendor": "axiomatic"}
    assert found[9].what.inputs == (0, 2, 3)
    assert found[9].what.options == {}, "no vendor is guessed"
    assert [doubt.split(" ")[0] for doubt in found[9].what.doubts] == ["input", "vendor:"]


@pytest.mark.simulated_time
async def test_vendor_is_known_by_a_name_of_several_segments() -> None:
    named = Cia404Node(5, lambda: TEMPERATURES, inputs=4, name="JUMO CANtrans T 902910/20")
    async with bus([named]) as (_, what):
        (found,) = (await scan(what)).found
    assert (found.what.profile, found.what.options) == ("cia404", {"vendor": "jumo"})
    assert found.what.evidence == "device profile 404, JUMO CANtrans T 902910/20"
    assert found.what.doubts == ()
    assert found.reads == "20.00 21.50 -3.00 40.00 degC"


class SilentNode:
    """Says that it is a measuring device, and is silent when it is asked for more."""

    def on_frame(self, identifier: int, data: bytes) -> Sequence[CanFrame]:
        if identifier != 0x607 or data[1:4] != bytes.fromhex("00 10 00"):
            return ()
        return ((0x587, bytes.fromhex("43 00 10 00 94 01 02 00")),)


@pytest.mark.simulated_time
async def test_node_that_falls_silent_is_reported_and_the_others_are_recognised() -> None:
    async with bus([SilentNode(), node(9)]) as (_, what):
        report = await scan(what)
    assert [device.unit for device in report.found] == [9]
    assert any(remark.startswith("node 7: no answer within") for remark in report.remarks)


@pytest.mark.simulated_time
async def test_bit_rate_is_found_by_listening_and_nobody_is_asked_at_another() -> None:
    talking = node(5, heartbeat_ms=20)
    spy = Spy()
    async with bus([talking, spy], bitrate=500_000) as (adapter, what):
        talking.start(adapter.send)
        report = await scan(replace(what, bitrates=(125_000, 250_000, 500_000, 1_000_000)))
        talking.stop()
    assert report.places[0].options["bitrate"] == 500_000
    assert report.found[0].what.evidence.endswith("pre-operational")


@pytest.mark.simulated_time
async def test_silent_bus_is_not_asked_at_several_rates_without_leave() -> None:
    spy = Spy()
    async with bus([node(5), spy], bitrate=250_000) as (_, what):
        several = replace(what, bitrates=(125_000, 250_000))
        report = await scan(several)
        assert report.question
        assert spy.frames == []
        allowed = await scan(replace(several, anyway=True))
    assert allowed.places[0].options["bitrate"] == 250_000
    assert [device.unit for device in allowed.found] == [5]


@pytest.mark.simulated_time
async def test_only_uploads_are_sent() -> None:
    spy = Spy()
    async with bus([node(5), spy]) as (_, what):
        await scan(what)
    assert len(spy.frames) > 127
    assert all(0x600 < identifier < 0x680 and data[0] == 0x40 for identifier, data in spy.frames)


@pytest.mark.simulated_time
async def test_node_that_is_heard_but_stopped_is_reported() -> None:
    stopped = node(5, heartbeat_ms=20)
    stopped.on_frame(0, bytes((Nmt.STOP, 5)))
    async with bus([stopped]) as (adapter, what):
        stopped.start(adapter.send)
        report = await scan(what)
        stopped.stop()
    assert report.found == []
    assert re.search(r"node 5 .*\(stopped\)", report.remarks[0])


@pytest.mark.simulated_time
async def test_two_nodes_with_one_id_are_reported() -> None:
    async with bus([node(5), node(5, "axiomatic")]) as (_, what):
        report = await scan(what)
    assert "node 5 answered twice: two nodes have this id; give one of them another" in report.remarks


@pytest.mark.simulated_time
async def test_plain_can_frames_are_listed() -> None:
    async with bus([node(5)]) as (adapter, what):
        logger = CanLogger(lambda: [20.0] * 6, adapter.send)
        logger.start()
        report = await scan(what)
        logger.stop()
    told = [remark for remark in report.remarks if "plain CAN" in remark]
    assert [remark.split(" ")[1] for remark in told] == ["0x300", "0x301"]


@pytest.mark.simulated_time
async def test_an_absent_server_says_what_to_check() -> None:
    async with bus([node(5)], bitrate=1_000_000) as (_, what):
        report = await scan(what)
    assert report.found == []
    (remark,) = report.remarks
    assert "125000 bit/s" in remark


@pytest.mark.simulated_time
def test_command_reaches_nodes_over_the_network_of_this_computer(tmp_path: Path) -> None:
    group, port, file = "239.74.163.9", free_port(), tmp_path / "gateway.toml"
    wire = MulticastBus([node(5)], group, port)
    wire.start()
    try:
        done = here(
            *("scan", "can", group, "--interface", "udp_multicast", "--udp-port", str(port)),
            *("--listen", "0.2", "--toml", str(file)),
        )
    finally:
        wire.stop()
    assert done.code == 0, done.err
    (device,) = load(file).devices
    assert (device.profile, device.unit, dict(device.options)) == ("cia404", 5, {"vendor": "esd"})


@pytest.mark.slow
async def test_ctrl_c_closes_the_adapter_and_shows_what_was_found() -> None:
    asked = asyncio.Event()

    class Slow(Cia404Node):
        def on_frame(self, identifier: int, data: bytes) -> Sequence[CanFrame]:
            if identifier > 0x600:
                asked.set()
            return super().on_frame(identifier, data)

    async with bus([Slow(5, lambda: TEMPERATURES, inputs=4, vendor="esd")]) as (_, what):
        arguments = (
            "scan",
            "can",
            what.settings.channel,
            "--interface",
            "slcan",
            "--bitrate",
            "125000",
            "--listen",
            "0.1",
        )
        done = await talc_gateway(*arguments, interrupt=asked.wait)
        assert [device.unit for device in (await scan(what)).found] == [5]  # nobody has the adapter any more
    assert "interrupted: " in done.out


def test_several_bit_rates_are_refused_where_the_system_sets_it() -> None:
    done = here("scan", "can", "can0", "--bitrate", "125000", "--bitrate", "250000")
    assert done.code == 2
    assert "cannot be changed" in done.err


@pytest.mark.parametrize(
    ("identifier", "data", "extended", "explained"),
    [(0x185, 8, False, True), (0x305, 8, False, True), (0x300, 8, False, False), (0x18FF0005, 8, True, False)],
)
def test_frames_of_a_known_node_are_explained(identifier: int, data: int, extended: bool, explained: bool) -> None:
    heard = Heard()
    heard.take(python_can.Message(arbitration_id=0x705, data=b"\x05", is_extended_id=False))
    heard.take(python_can.Message(arbitration_id=identifier, data=bytes(data), is_extended_id=extended))
    assert (heard.unexplained() == {}) == explained


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("10.0.0.1",), "error: channel: '10.0.0.1': expected a multicast group, such as 239.74.163.2"),
        (("can0",), "error: channel: 'can0': expected a multicast group"),
        (("239.74.163.2", "--udp-port", "0"), "Invalid value for '--udp-port': 0 is not in the range"),
    ],
)
def test_invalid_group_is_refused(options: tuple[str, ...], says: str) -> None:
    done = here("scan", "can", *options, "--interface", "udp_multicast")
    assert done.code == 2
    assert says in done.err


@pytest.mark.simulated_time
async def test_a_bug_in_the_library_is_a_remark_and_the_other_nodes_are_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    sends, failures = Network.send_message, [KeyError("no such key")]

    def buggy(network: Network, identifier: int, *arguments: object, **named: object) -> None:
        if failures and identifier == 0x605:  # a request to node 5
            raise failures.pop()
        sends(network, identifier, *arguments, **named)  # type: ignore[arg-type]

    monkeypatch.setattr(Network, "send_message", buggy)
    async with bus([node(5), node(7)]) as (_, what):
        report = await scan(what)
    assert not failures
    assert [device.unit for device in report.found] == [7]
    assert "unexpected KeyError in the recognition of node 5: 'no such key'" in report.remarks
