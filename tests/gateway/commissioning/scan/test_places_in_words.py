"""Host and port in a text: an address of IPv6 is in brackets wherever it is shown, so that the port is not its end."""

import pytest

from drivers.agent.settings import AgentBusSettings
from drivers.base import ConnectError
from drivers.byte_stream import TcpStream
from drivers.modbus.settings import ModbusTcpSettings
from drivers.mqtt.settings import MqttBusSettings
from drivers.section import host_and_port
from gateway.commissioning.agent_test.connection import AgentUnderTest, Unreachable, connected
from gateway.commissioning.scan.found import ScanReport
from gateway.commissioning.scan.tcp import TcpScan, scan_hosts
from gateway.config.controls import AgentNc
from gateway.config.telemetry import endpoint
from tests.benches.free_port import free_port


@pytest.mark.parametrize(
    ("host", "text"), [("::1", "[::1]:502"), ("127.0.0.1", "127.0.0.1:502"), ("mill-7", "mill-7:502")]
)
def test_host_and_port_are_written_as_in_a_url(host: str, text: str) -> None:
    assert host_and_port(host, 502) == text


def test_places_and_addresses_are() -> None:
    agent = {"host": "::1", "key_file": "agent.key"}
    assert AgentBusSettings.model_validate(agent).place == "[::1]:7621"
    assert AgentNc.model_validate({"kind": "agent"} | agent).address == "[::1]:7621"
    assert ModbusTcpSettings(host="::1").place == "[::1]:502"
    assert MqttBusSettings(url="mqtt://[::1]").place == "[::1]:1883"
    assert endpoint("tcp/[::]:7448").from_here == "tcp/[::1]:7448"


async def test_messages_are() -> None:
    port = free_port()
    with pytest.raises(ConnectError, match=rf"cannot connect to \[::1\]:{port}: "):
        await TcpStream("bus1", "::1", port).open(60.0)
    with pytest.raises(Unreachable, match=rf"^\[::1\]:{port}: "):
        async with connected(AgentUnderTest("::1", port, b"k" * 40, 60.0)):
            raise AssertionError("nobody listens there")
    told = list[str]()
    report: ScanReport = await scan_hosts(
        TcpScan((("::1", port),), (1,), 60.0), lambda _, text: told.append(text), lambda: False
    )
    assert f"[::1]:{port}" in told
    assert any(f"[::1]:{port}" in remark for remark in report.remarks)
