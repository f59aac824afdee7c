"""Nodes of a foreign OPC UA server (asyncua's) as channels: values, statuses, ages, unknown nodes, lost sessions."""

import asyncio
import re
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import cast

import pytest
from asyncua.client.ua_client import UaClient
from asyncua.common.callback import Callback, CallbackType, ServerItemCallback
from asyncua.common.utils import ServiceError
from asyncua.ua.status_codes import StatusCodes
from asyncua.ua.ua_binary import uatcp_to_binary
from asyncua.ua.uaerrors import BadTooManyOperations
from asyncua.ua.uaprotocol_hand import ErrorMessage, MessageType
from asyncua.ua.uatypes import Int16, NodeId, StatusCode, String, UInt32, Variant, VariantType

from drivers.base import (
    BadAnswer,
    Bus,
    ConnectError,
    Driver,
    Quality,
    Reading,
    SetupError,
    SystemClock,
    WrongDevice,
)
from drivers.build import make_device
from drivers.opcua.bus import OpcUaBus
from drivers.opcua.device import OpcUaDevice
from drivers.opcua.nodes import NodeName, NodeValue, node_name
from drivers.opcua.profile import OpcUaProfile
from drivers.opcua.settings import OpcUaBusSettings
from drivers.problems import settings_of
from tests.benches.buses import make_bus
from tests.benches.driver_reads import told
from tests.benches.opcua_drives import URI, Drives
from tests.benches.refusals import refusing

pytestmark = pytest.mark.simulated_time

PROFILE = f"""
protocol = "opcua"
title = "drives"
unit = "degC"
namespace = "{URI}"
[[node]]
node = "s=motor"
[[node]]
node = "s=bearing"
scale = 0.1
offset = -5.0
unit = "K"
low = 0.0
high = 100.0
[[node]]
node = "s=axes"
element = 1
[[node]]
node = "nsu={URI};s=name"
[[node]]
node = "s=absent"
[[node]]
node = "nsu=urn:nobody;s=motor"
[[node]]
node = "ns=0;i=2255"
"""
COUNT = 7
_AT_LOW_LIMIT, _AT_HIGH_LIMIT = 0x0500, 0x0600
"""Good, with the details of a value that its source cannot measure further (Part 4, 7.39)."""


@asynccontextmanager
async def device_at(
    url: str, folder: Path, text: str = PROFILE, count: int = COUNT
) -> AsyncIterator[tuple[Bus, Driver]]:
    profile = folder / "drives.toml"
    profile.write_text(text)
    bus = make_bus("opc1", "opcua", {"url": url, "security": "none", "timeout_s": 5.0})
    device = make_device("drives", bus, str(profile), 1, {f"c{i}": i for i in range(count)}, {}, SystemClock())
    try:
        await bus.connect()
        yield bus, device
    finally:
        await bus.close()


@pytest.mark.slow
async def test_values_statuses_and_nodes_that_are_not_there(tmp_path: Path) -> None:
    server = Drives()
    await server.start()
    try:
        async with device_at(server.url, tmp_path) as (_, device):
            await device.connect()
            values = told(await device.read())
            assert values[:3] == [(61.25, "degC"), (pytest.approx(38.1), "K"), (48.0, "degC")]
            assert values[3] == ("sensor_fault", "the node holds no number: 'drive'")
            absent = "the server reports BadNodeIdUnknown: compare the id with the server's own names, case included"
            assert values[4] == ("comm_fault", absent)
            assert values[5] == ("comm_fault", absent.replace("Unknown", "Invalid"))
            assert values[6][0] == "sensor_fault", "an array of texts"

            expected = {
                StatusCodes.BadSensorFailure: "sensor_fault",
                StatusCodes.BadDeviceFailure: "sensor_fault",
                StatusCodes.BadConfigurationError: "sensor_fault",
                StatusCodes.BadOutOfRange: "out_of_range",
                StatusCodes.BadNoCommunication: "comm_fault",
                StatusCodes.BadWaitingForInitialData: "comm_fault",
                StatusCodes.UncertainLastUsableValue: "stale",
                StatusCodes.UncertainNoCommunicationLastUsableValue: "stale",
                StatusCodes.UncertainEngineeringUnitsExceeded: "out_of_range",
                StatusCodes.UncertainOverRange: "out_of_range",
                StatusCodes.UncertainUnderRange: "out_of_range",
                StatusCodes.UncertainSensorNotAccurate: "sensor_fault",
                StatusCodes.UncertainSubstituteValue: "sensor_fault",
                StatusCodes.GoodLocalOverride: "sensor_fault",
                StatusCodes.GoodClamped: "good",
                _AT_LOW_LIMIT: "out_of_range",
                _AT_HIGH_LIMIT: "out_of_range",
            }
            found = {}
            for status in expected:
                await server.set("motor", 61.25, status)
                first, second, *_ = await device.read()
                assert second.quality is Quality.GOOD, "a neighbour's status is the neighbour's"
                found[status] = first.quality.value
            assert found == expected
            await server.set("motor", 61.25, StatusCodes.BadAttributeIdInvalid)  # of a variable that a control lacks
            assert told(await device.read())[0] == ("comm_fault", absent.replace("NodeIdUnknown", "AttributeIdInvalid"))
            await server.set("bearing", 1051)
            assert told(await device.read())[1] == ("out_of_range", "100.1 is beyond the profile's limits")
            await server.set("motor", float("nan"))
            assert told(await device.read())[0][0] == "sensor_fault"
            await server.set("axes", [1.5])
            assert told(await device.read())[2] == ("sensor_fault", "the node holds no element 1: [1.5]")

        nothing = PROFILE.split("[[node]]")[0] + '[[node]]\nnode = "s=Motor"\n'
        async with device_at(server.url, tmp_path, nothing, 1) as (_, stranger):
            with pytest.raises(
                WrongDevice, match=r"bus opc1, device drives: .* none of the nodes nsu=urn:maker:drives;s=Motor"
            ):
                await stranger.connect()

        aged = PROFILE.split("[[node]]")[0] + 'max_age_s = 30\n[[node]]\nnode = "s=motor"\n'
        async with device_at(server.url, tmp_path, aged, 1) as (bus, device):
            await server.set("motor", 20.0, age_s=20)
            assert told(await device.read()) == [(20.0, "degC")]
            await server.set("motor", 20.0, age_s=90)
            ((quality, detail),) = told(await device.read())
            assert quality == "stale"
            assert re.fullmatch(r"the server's source measured it (89|90|91) s ago", detail), detail
            await server.set("motor", 20.0, age_s=None)
            unknown = "the server does not say when the value was measured; omit max_age_s"
            assert told(await device.read()) == [("stale", unknown)]
            await server.set("motor", 20.0, age_s=-20)
            assert told(await device.read()) == [(20.0, "degC")], "two clocks are never quite the same"
            await server.set("motor", 20.0, age_s=-3600)
            ((quality, detail),) = told(await device.read())
            assert quality == "stale", "a value that stands still from then on would look new for an hour"
            assert re.match(r"its source timestamp is (3599|3600|3601) s ahead of the server's clock; ", detail), detail
            await server.server.stop()
            with pytest.raises(ConnectError, match="bus opc1, device drives"):
                await device.read()
            server = Drives(server.url)
            await server.start()
            await bus.connect()
            assert told(await device.read()) == [(61.25, "degC")], "in a new session"
    finally:
        await server.server.stop()


SERVERS_NOON = datetime(2001, 2, 3, 12, tzinfo=UTC)
"""By the clock of a server that nobody has set."""


@asynccontextmanager
async def with_own_clock(folder: Path, max_age_s: float | None = 30.0) -> AsyncIterator[tuple[Drives, Driver]]:
    """A server whose clock the test sets, and a device with one channel."""
    server = Drives()
    server.server.disable_clock()
    await server.start()
    text = PROFILE.split("[[node]]")[0] + ("" if max_age_s is None else f"max_age_s = {max_age_s}\n")
    try:
        await server.set_clock(SERVERS_NOON)
        async with device_at(server.url, folder, text + '[[node]]\nnode = "s=motor"\n', 1) as (_, device):
            yield server, device
    finally:
        await server.server.stop()


async def read_aged(device: Driver, quality: Quality, age_s: float) -> Reading:
    """The channel's reading, which must have this quality and age."""
    (reading,) = await device.read()
    assert reading.quality is quality
    assert SystemClock().monotonic() - reading.monotonic_s == pytest.approx(age_s, abs=1e-3)
    assert (SystemClock().utc() - reading.source_time).total_seconds() == pytest.approx(age_s, abs=1e-3)
    return reading


async def test_with_max_age_a_value_is_as_old_as_its_source_says(tmp_path: Path) -> None:
    """Only by the server's clock, which is 25 years behind this computer's."""
    async with with_own_clock(tmp_path) as (server, device):
        await server.set("motor", 20.0, age_s=20, now=SERVERS_NOON)
        await read_aged(device, Quality.GOOD, 20.0)
        await server.set("motor", 20.0, age_s=90, now=SERVERS_NOON)
        await read_aged(device, Quality.STALE, 90.0)
        await server.set("motor", 20.0, age_s=None)
        await read_aged(device, Quality.STALE, 0.0)
        await server.set("motor", 20.0, StatusCodes.BadSensorFailure, age_s=90, now=SERVERS_NOON)
        await read_aged(device, Quality.SENSOR_FAULT, 0.0)  # it is broken now


async def test_a_value_that_stands_still_ages_although_the_servers_clock_does_not_go_on(tmp_path: Path) -> None:
    """The times of one measurement are equal at each reading, so that a spike that is read twice is one spike."""
    async with with_own_clock(tmp_path) as (server, device):
        await server.set("motor", 20.0, age_s=-20, now=SERVERS_NOON)
        first = await read_aged(device, Quality.GOOD, 0.0)  # it is not newer than its reading
        await asyncio.sleep(25.0)
        second = await read_aged(device, Quality.GOOD, 25.0)
        assert second.monotonic_s == pytest.approx(first.monotonic_s, abs=1e-3)
        await server.set_clock(SERVERS_NOON - timedelta(hours=1))
        await asyncio.sleep(6.0)
        await read_aged(device, Quality.STALE, 31.0)
        await server.set("motor", 20.0, age_s=1, now=SERVERS_NOON - timedelta(hours=1))
        await read_aged(device, Quality.GOOD, 1.0)  # another measurement


async def test_without_max_age_a_value_is_as_old_as_its_reading(tmp_path: Path) -> None:
    """A timestamp may then say when the value changed last."""
    async with with_own_clock(tmp_path, None) as (server, device):
        await server.set("motor", 20.0, age_s=90, now=SERVERS_NOON)
        await read_aged(device, Quality.GOOD, 0.0)


async def test_an_impossible_source_time_spoils_no_time_of_a_reading(tmp_path: Path) -> None:
    """OPC UA writes 1601 for no time; the server's clock is at the end of its range."""
    async with with_own_clock(tmp_path) as (server, device):
        await server.set_clock(datetime(9999, 12, 31, tzinfo=UTC))
        await server.set("motor", 20.0, age_s=0, now=datetime(1601, 1, 2, tzinfo=UTC))
        await read_aged(device, Quality.STALE, 86_400.0)


GONE = [
    getattr(StatusCodes, f"Bad{name}")
    for name in (
        "SessionIdInvalid", "SessionClosed", "SessionNotActivated", "SecureChannelClosed", "SecureChannelIdInvalid",
        "SecureChannelTokenUnknown", "TcpSecureChannelUnknown", "SecurityChecksFailed", "Shutdown",
    )
]  # fmt: skip
"""What a server answers that has lost the session or its channel, or is about to."""


async def read_until_it_fails(device: Driver) -> None:
    """Read until it fails; what is on its way may still be answered."""
    async with asyncio.timeout(60.0):
        while True:
            await device.read()


async def test_a_session_or_channel_that_the_server_has_forgotten_is_opened_again(tmp_path: Path) -> None:
    """It answers each request so, on a connection that stays open; only another session helps."""
    server = Drives()
    await server.start()
    seen: list[object] = []
    forgotten: dict[int, int] = {}
    text = PROFILE.split("[[node]]")[0] + '[[node]]\nnode = "s=motor"\n'

    def before_read(event: Callback, _: object) -> None:
        if isinstance(event, ServerItemCallback) and event.is_external:
            seen.append(event.user)  # each session has its own
            if (code := forgotten.get(id(event.user))) is not None:
                raise ServiceError(code)

    try:
        async with device_at(server.url, tmp_path, text, 1) as (_, device):
            server.server.iserver.callback_service.addListener(cast("str", CallbackType.PreRead), before_read)
            for code in GONE:
                assert told(await device.read()) == [(61.25, "degC")]
                forgotten[id(seen[-1])] = code
            assert told(await device.read()) == [(61.25, "degC")]
            assert server.server.bserver is not None
            (connection,) = server.server.bserver.clients
            assert connection.transport is not None
            unknown = ErrorMessage(StatusCode(UInt32(StatusCodes.BadTcpSecureChannelUnknown)), String("who is there?"))
            connection.transport.write(uatcp_to_binary(cast("MessageType", MessageType.Error), unknown))
            for _ in range(10):
                assert told(await device.read()) == [(61.25, "degC")]
            assert len({id(one) for one in seen}) == len(GONE) + 2
    finally:
        await server.server.stop()


async def test_a_session_whose_namespaces_are_not_known_is_not_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A new one is opened; an index of an earlier session could belong to another namespace by now."""
    server = Drives()
    await server.start()
    try:
        async with device_at(server.url, tmp_path) as (bus, device):
            await bus.close()
            with monkeypatch.context() as patched:
                patched.setattr(UaClient, "read_attributes", busy)
                for asked in (bus.connect, device.read):
                    with refusing(BadAnswer, "opcua_answers status=BadTooManyOperations opcua_reads_namespaces"):
                        await asked()
            await bus.connect()
            assert told(await device.read())[0] == (61.25, "degC")
    finally:
        await server.server.stop()


async def test_a_truth_value_is_a_number_only_where_the_unit_is_one(tmp_path: Path) -> None:
    """A node with a truth value instead of a temperature is not 1 degC."""
    server = Drives()
    await server.start()
    text = PROFILE.split("[[node]]")[0] + '[[node]]\nnode = "s=flag"\n[[node]]\nnode = "s=flag"\nunit = "1"\n'
    try:
        await server.server.nodes.objects.add_variable(server.node("flag"), "flag", True)
        async with device_at(server.url, tmp_path, text, 2) as (_, device):
            as_degrees, as_number = told(await device.read())
            assert as_degrees == ("sensor_fault", 'the node holds True, which is a number only with unit = "1"')
            assert as_number == (1.0, "1")
    finally:
        await server.server.stop()


async def test_namespaces_in_another_order_after_a_restart_give_no_value_of_another_node(tmp_path: Path) -> None:
    """The previous index now belongs to another maker, who has a node of the same name."""
    server = Drives()
    await server.start()
    url = server.url
    text = PROFILE.split("[[node]]")[0] + '[[node]]\nnode = "s=motor"\n'
    try:
        async with device_at(url, tmp_path, text, 1) as (_, device):
            assert told(await device.read()) == [(61.25, "degC")]
            before = server.index
            await server.server.stop()
            server = Drives(url, first=("urn:a", "urn:b"))
            await server.start()
            assert await server.server.get_namespace_index("urn:b") == before
            other = NodeId(String("motor"), Int16(before))
            await server.server.nodes.objects.add_variable(other, "motor", -40.0)
            assert told(await device.read()) == [(61.25, "degC")]
    finally:
        await server.server.stop()


async def test_an_index_that_becomes_another_namespaces_gives_no_value(tmp_path: Path) -> None:
    """The node is named by an index, and after a restart another maker has a node of that name there."""
    server = Drives()
    await server.start()
    url, before = server.url, server.index
    named = f'[[node]]\nnode = "ns={before};s=motor"\n[[node]]\nnode = "nsu={URI};s=motor"\n'
    text = PROFILE.split("[[node]]")[0] + named
    try:
        async with device_at(url, tmp_path, text, 2) as (_, device):
            assert told(await device.read()) == [(61.25, "degC")] * 2
            await server.server.stop()
            server = Drives(url, first=("urn:a", "urn:b"))
            await server.start()
            await server.server.nodes.objects.add_variable(NodeId(String("motor"), Int16(before)), "motor", -40.0)
            for _ in range(2):
                by_index, by_uri = told(await device.read())
                assert by_index[0] == "comm_fault"
                assert URI in str(by_index[1])
                assert "urn:b" in str(by_index[1])
                assert by_uri == (61.25, "degC")
    finally:
        await server.server.stop()


@pytest.mark.parametrize("stated", [True, False])
async def test_no_more_nodes_are_read_at_once_than_the_server_allows(tmp_path: Path, stated: bool) -> None:
    server, most = Drives(), 3
    asked: list[int] = []

    async def few(event: Callback, _dispatcher: object) -> None:
        if isinstance(event, ServerItemCallback) and event.is_external:
            asked.append(len(event.request_params.NodesToRead))
            if asked[-1] > most:
                raise ServiceError(StatusCodes.BadTooManyOperations)

    await server.start()
    try:
        if stated:
            limit = server.server.get_node(NodeId.from_string("i=11705"))
            await limit.write_value(Variant(most, VariantType.UInt32))
        server.server.iserver.callback_service.addListener(cast("str", CallbackType.PreRead), few)
        async with device_at(server.url, tmp_path) as (_, device):
            asked.clear()
            for _ in range(2):
                assert told(await device.read())[2] == (48.0, "degC")
        assert len([count for count in asked if count > most]) == (0 if stated else 1)
    finally:
        await server.server.stop()


async def busy(*_: object) -> list[str]:
    raise BadTooManyOperations


@pytest.mark.parametrize(
    ("held", "element", "value"),
    [
        ([61.5], None, 61.5),
        (61.5, 0, 61.5),
        ([61.5, 62.5], None, None),
        (61.5, 1, None),
        ("00317.5", None, 317.5),
        (" +21. ", None, 21.0),
        ("21,5", None, None),
        (["21.5"], None, 21.5),
    ],
)
async def test_what_holds_one_number_is_that_number(held: object, element: int | None, value: float | None) -> None:
    class Says(OpcUaBus):
        async def read(
            self, device: str, nodes: Sequence[NodeName], *, aged: bool = False, again: bool = False
        ) -> list[NodeValue]:
            return [NodeValue(held)]

    node = {"node": "i=1"} | ({} if element is None else {"element": element})
    profile = settings_of(OpcUaProfile, {"protocol": "opcua", "title": "x", "unit": "K", "node": [node]})
    bus = Says("opc", settings_of(OpcUaBusSettings, {"url": "opc.tcp://127.0.0.1", "security": "none"}))
    (reading,) = await OpcUaDevice("d", bus, profile, {"c": 0}, SystemClock()).read()
    assert reading.value == value if value is not None else reading.quality is Quality.SENSOR_FAULT


@pytest.mark.parametrize(
    ("url", "place"),
    [
        ("opc.tcp://[fd00::5]", "opc.tcp://[fd00::5]:4840"),
        ("opc.tcp://[fd00::5]:48010/x", "opc.tcp://[fd00::5]:48010/x"),
        ("OPC.TCP://drives:48010", "opc.tcp://drives:48010"),
    ],
)
def test_an_address_of_ipv6_or_in_capitals_is_one(url: str, place: str) -> None:
    assert settings_of(OpcUaBusSettings, {"url": url, "security": "none"}).place == place


@pytest.mark.parametrize("port", [0, 65536, 99999])
def test_a_port_that_there_is_not_is_an_invalid_address(port: int) -> None:
    with pytest.raises(SetupError, match="expected a port of 1 to 65535"):
        make_bus("opc1", "opcua", {"url": f"opc.tcp://drives:{port}", "security": "none"})


def test_a_bus_that_is_not_used_loads_no_library() -> None:
    bus = make_bus("opc1", "opcua", {"url": "opc.tcp://nowhere", "security": "none"})
    assert isinstance(bus, OpcUaBus)
    assert bus.timeout_s == 2.0


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("i=2258", "i=2258"),
        ("ns=2;s=/Plc/MB1", "ns=2;s=/Plc/MB1"),
        ("s=a;b=c", "nsu=urn:here;s=a;b=c"),
        (
            "nsu=http://maker/x;g=09087e75-8e5e-499b-954f-f2a9603db28a",
            "nsu=http://maker/x;g=09087e75-8e5e-499b-954f-f2a9603db28a",
        ),
        ("ns=0;i=1", "i=1"),
    ],
)
def test_names_of_nodes(text: str, shown: str) -> None:
    assert str(node_name(text, "urn:here" if text.startswith("s=") else None)) == shown


@pytest.mark.parametrize(
    "text", ["", "motor", "ns=65536;i=1", "i=4294967296", f"g={'-' * 36}", "ns=2", "x=1", "i=-1", "ns=99999999999;s=a"]
)
def test_a_node_id_that_no_request_can_carry_is_refused(text: str) -> None:
    """Otherwise each request for the device's nodes would end the session as if the server's answer were malformed."""
    with pytest.raises(ValueError, match="is not a node id"):
        node_name(text)
