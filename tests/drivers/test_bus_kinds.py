"""Every bus has the kind by which a configuration names it."""

from collections.abc import Mapping
from pathlib import Path

import pytest

from drivers.base import SetupError
from drivers.build import BUS_KINDS, check_device
from drivers.bus_settings import Here
from drivers.problems import read_settings
from tests.benches.buses import make_bus

HOST = {"host": "127.0.0.1", "port": 1}
LINE = {"port": "/nowhere"}
PLACES: Mapping[str, Mapping[str, object]] = {
    "modbus_rtu": LINE, "modbus_rtu_tcp": HOST, "modbus_tcp": HOST, "me_rs485": LINE, "me_ethernet": HOST,
    "canopen": {"channel": "can0"}, "can": {"channel": "can0"}, "mqtt": {"url": "mqtt://127.0.0.1"},
    "opcua": {"url": "opc.tcp://127.0.0.1", "security": "none"}, "agent": {"key_file": "agent.key"},
}  # fmt: skip


@pytest.mark.parametrize("kind", PLACES)
def test_a_bus_is_of_its_kind_and_a_message_names_it(kind: str, tmp_path: Path) -> None:
    (tmp_path / "agent.key").write_text("k" * 40)
    place = dict(PLACES[kind]) | ({"key_file": str(tmp_path / "agent.key")} if kind == "agent" else {})
    assert make_bus("bus1", kind, place).kind == kind
    settings = read_settings(BUS_KINDS[kind], place)
    profile = "icpdas_m7015" if kind == "canopen" else "cia404"
    with pytest.raises(SetupError) as raised:
        check_device("device1", "bus1", settings, profile, 1, {"t0": 0}, {})
    assert raised.value.what.code == "profile_misfit"
    assert raised.value.what.values == {"profile": profile, "kind": kind}


PROFILES = {
    "opcua": '[[node]]\nnode = "ns=2;i=1"\n',
    "mqtt": 'max_age_s = 3.0\n[[topic]]\ntopic = "hall/north"\n',
    "agent": '[[value]]\nname = "x"\n',
    "can_dbc": 'dbc = "logger.dbc"\n[[signal]]\nmessage = "M"\nname = "T"\n',
}
"""Protocol of an own profile to its channels."""
DBC = 'BU_: L\nBO_ 768 M: 8 L\n SG_ T : 0|16@1+ (0.01,-273.15) [-273.15|382.2] "degC" L\n'


@pytest.mark.parametrize("kind", ["can", "me_ethernet", "opcua", "mqtt", "agent"])
def test_a_bus_without_addresses_takes_whatever_a_file_states(kind: str, tmp_path: Path) -> None:
    (tmp_path / "logger.dbc").write_text(DBC)
    profile = "me_ethernet"
    if kind != "me_ethernet":
        protocol = "can_dbc" if kind == "can" else kind
        own = tmp_path / "own.toml"
        own.write_text(f'protocol = "{protocol}"\ntitle = "own"\nunit = "degC"\n{PROFILES[protocol]}')
        profile = str(own)
    options = {"range_um": 500.0} if kind == "me_ethernet" else {}
    for unit in (0, 1, 0xFFFF):
        check_device("device1", "bus1", read_settings(BUS_KINDS[kind], PLACES[kind]), profile, unit, {"t0": 0}, options)


@pytest.mark.parametrize("kind", PLACES)
def test_a_bus_of_any_kind_can_be_moved_to_this_computer(kind: str, tmp_path: Path) -> None:
    moved = BUS_KINDS[kind].moved(Here(f"{tmp_path}/line", 4711))
    fields = {field: value for field, value in {**PLACES[kind], **moved}.items() if value is not None}
    place = read_settings(BUS_KINDS[kind], fields).place
    assert place.endswith((f"{tmp_path}/line", "127.0.0.1:4711"))


@pytest.mark.parametrize("kind", ["modbus_rtu", "me_rs485"])
def test_a_line_that_is_moved_switches_no_rts(kind: str) -> None:
    """A pseudo-terminal has none, and the port would not open."""
    switched = {"port": "/dev/ttyS1", "rs485_rts": "high", "rs485_before_s": 0.001, "rs485_after_s": 0.002}
    fields = read_settings(BUS_KINDS[kind], switched).model_dump() | BUS_KINDS[kind].moved(Here("/here/line", 4711))
    moved = read_settings(BUS_KINDS[kind], {field: value for field, value in fields.items() if value is not None})
    assert moved == read_settings(BUS_KINDS[kind], {"port": "/here/line"})
