"""The limits that a new configuration has. A change of one changes what every gateway does that does not set it."""

from collections.abc import Mapping
from inspect import signature
from typing import Any

import pytest
from pydantic import BaseModel

from drivers.agent.settings import AgentSettings
from drivers.mqtt.settings import MqttServer
from drivers.opcua.settings import OpcUaServer, with_port
from drivers.sinumerik.settings import Handshake
from gateway.config.buses import SECTIONS
from gateway.config.controls import AgentNc, LinuxCncNc, MtConnectNc, Nc, SinumerikNc
from gateway.config.sections import Compensation, Storage
from gateway.listeners.outlets.influxdb import InfluxDbSettings
from gateway.listeners.outlets.mqtt import MqttOutletSettings
from gateway.storage.store import Store

POLLED = {"period_s": 1.0, "read_limit_s": 10.0, "retry_max_periods": 60}
WIRE = POLLED | {"timeout_s": 0.5}
SERVER = POLLED | {"timeout_s": 2.0}
CONTROL = {"period_s": 1.0, "timeout_s": 2.0}
OUTLET = {"most_waiting": 20_000, "timeout_s": 10.0, "reading_every_s": 0.0}
SHIPPED: Mapping[type[BaseModel], Mapping[str, Any]] = {
    SECTIONS["modbus_rtu"]: WIRE,
    SECTIONS["modbus_rtu_tcp"]: WIRE,
    SECTIONS["modbus_tcp"]: WIRE | {"port": 502},
    SECTIONS["canopen"]: WIRE | {"port": 43113},
    SECTIONS["can"]: WIRE | {"port": 43113},
    SECTIONS["me_rs485"]: WIRE,
    SECTIONS["me_ethernet"]: WIRE | {"port": 10001},
    SECTIONS["mqtt"]: SERVER | {"keepalive_s": 30},
    SECTIONS["opcua"]: SERVER,
    SECTIONS["agent"]: SERVER | {"port": 7621},
    AgentNc: CONTROL | {"port": 7621, "request_valid_for_s": 900.0},
    LinuxCncNc: CONTROL | {"port": 7621},
    MtConnectNc: CONTROL,
    SinumerikNc: CONTROL,
    Compensation: {
        "stale_after_s": 900.0, "inputs_stale_after_s": 1800.0, "measurement_stale_after_s": 57600.0,
        "frozen_after_s": 120.0, "watchdog_s": 10.0, "slew_um_per_s": 1.0,
    },
    Storage: {
        "keep_samples_days": 7.0, "keep_minutes_days": 400.0, "most_mb": 4000.0, "commit_s": 20.0,
        "unstored_after_s": 60.0, "warn_free_mb": 500.0, "compensate_unstored": False,
    },
    MqttOutletSettings: OUTLET | {"keepalive_s": 30},
    InfluxDbSettings: OUTLET | {"gather_for_s": 5.0, "lines_at_once": 1000},
}  # fmt: skip


@pytest.mark.parametrize("section", SHIPPED, ids=lambda section: section.__name__)
def test_a_limit_that_is_not_given_is_the_shipped_one(section: type[BaseModel]) -> None:
    found = {name: section.model_fields[name].default for name in SHIPPED[section]}
    assert found == SHIPPED[section]


def test_the_store_s_times_are_the_shipped_ones() -> None:
    """`run` gives the store its own `commit_s` and `silent_s`; the others have the values stated here."""
    found = {name: parameter.default for name, parameter in signature(Store).parameters.items()}
    shipped = {"commit_s": 20.0, "retry_s": 5.0, "look_s": 10.0, "hangs_after_s": 30.0, "silent_s": 30.0}
    assert {name: found[name] for name in shipped} == shipped


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
