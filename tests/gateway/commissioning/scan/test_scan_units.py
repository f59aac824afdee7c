"""A scan asks every address that a device of a configuration can have, and no other."""

from collections.abc import Mapping

import pytest

from drivers.base import SetupError
from drivers.build import BUS_KINDS, check_device
from drivers.problems import read_settings
from tests.benches.command import here
from tests.benches.refusals import refusing

HOST, LINE = {"host": "127.0.0.1", "port": 1}, {"port": "/nowhere"}
DEVICES: Mapping[str, tuple[str, Mapping[str, object]]] = {
    "modbus_rtu": ("icpdas_m7015", LINE), "modbus_rtu_tcp": ("icpdas_m7015", HOST),
    "modbus_tcp": ("advantech_adam6015", HOST), "canopen": ("cia404", {"channel": "can0"}),
    "me_rs485": ("me_rs485", LINE),
}  # fmt: skip
"""Profile of a device on each kind of bus, and where the bus is."""


@pytest.mark.parametrize(
    ("words", "kind", "lowest", "highest"),
    [
        (("scan", "serial", "/nowhere", "--units"), "modbus_rtu", 1, 247),
        (("scan", "serial", "/nowhere", "--me-addresses"), "me_rs485", 2, 126),
        (("scan", "tcp", "127.0.0.1", "--units"), "modbus_tcp", 0, 255),
        (("scan", "tcp", "127.0.0.1:4001", "--rtu", "--units"), "modbus_rtu_tcp", 1, 247),
        (("scan", "can", "nowhere", "--nodes"), "canopen", 1, 127),
    ],
)
def test_its_bounds_are_those_of_a_configuration(words: tuple[str, ...], kind: str, lowest: int, highest: int) -> None:
    profile, place = DEVICES[kind]
    settings = read_settings(BUS_KINDS[kind], place)
    for unit in (lowest - 1, highest + 1):
        done = here(*words, str(unit)) if unit >= 0 else None
        assert done is None or (done.code == 2 and f"expected {lowest} to {highest}" in done.err), done
        with refusing(SetupError, f"unit: unit_beyond unit={unit} low={lowest} high={highest} kind={kind}"):
            check_device("device1", "bus1", settings, profile, unit, {"c0": 0}, {})
