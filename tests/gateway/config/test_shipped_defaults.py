"""What a new configuration has without a default of a field, which docs/configuration.md would show."""

from drivers.agent.settings import AgentSettings
from drivers.mqtt.settings import MqttServer
from drivers.opcua.settings import OpcUaServer, with_port
from drivers.sinumerik.settings import Handshake
from gateway.config.controls import AgentNc, LinuxCncNc, MtConnectNc, Nc, SinumerikNc
from gateway.listeners.outlets.influxdb import InfluxDbSettings


def test_a_server_whose_port_is_not_given_is_looked_for_at_the_usual_one() -> None:
    assert [MqttServer(url=f"{scheme}://127.0.0.1").port for scheme in ("mqtts", "mqtt")] == [8883, 1883]
    given = {"name": "plant", "kind": "influxdb", "database": "talc"}
    urls = ("https://127.0.0.1", "http://127.0.0.1")
    assert [InfluxDbSettings.model_validate(given | {"url": url}).port for url in urls] == [8086, 8086]
    server = OpcUaServer(url="opc.tcp://127.0.0.1", security="none")
    assert with_port(server.url) == "opc.tcp://127.0.0.1:4840"


def test_no_control_is_sent_more_than_half_a_millimetre_or_keeps_a_request_for_more_than_a_quarter_of_an_hour() -> None:
    agent = {"key_file": "talc.key"}
    items = {axis: f"{axis}abs" for axis in "XYZAC"}
    controls: list[Nc] = [
        SinumerikNc.model_validate({"kind": "sinumerik", "url": "opc.tcp://127.0.0.1", "security": "none"}),
        AgentNc.model_validate({"kind": "agent"} | agent),
        LinuxCncNc.model_validate({"kind": "linuxcnc"} | agent),
        MtConnectNc.model_validate({"kind": "mtconnect", "url": "http://127.0.0.1:5000", "positions": items}),
    ]
    assert {type(nc).__name__: nc.largest_um for nc in controls} == {
        "SinumerikNc": 500.0, "AgentNc": 500.0, "LinuxCncNc": 500.0, "MtConnectNc": 500.0,
    }  # fmt: skip
    assert AgentSettings.model_validate(agent).largest_um == 500.0
    assert AgentSettings.model_validate(agent).request_valid_for_s == 900.0
    assert Handshake().request_valid_for_s == 900.0
