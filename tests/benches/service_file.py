"""Small configurations that a whole service runs with, and the largest of the valid cases."""

from collections.abc import Mapping
from pathlib import Path

from gateway.config.extended import validate
from gateway.config.model import GatewayConfig

FILE = Path(__file__).parents[1] / "gateway" / "config" / "cases" / "valid" / "gateway.toml"
MACHINE = """
[machine]
name = "mill"
"""
UNPUBLISHED = f"""{MACHINE}
[telemetry]
enabled = false
"""
"""A machine that opens no Zenoh session."""


def rtu_bus(port: str = "/nowhere/adapter", fields: str = "") -> str:
    """The bus `rtu1`."""
    return f"""
[[bus]]
name = "rtu1"
kind = "modbus_rtu"
port = "{port}"
{fields}
"""


def m7015(
    name: str = "rtd1", unit: int | str = 1, channels: str = "bed_front = 0", profile: str = "icpdas_m7015"
) -> str:
    """A thermometer module on `rtu1`."""
    return f"""
[[device]]
name = "{name}"
bus = "rtu1"
profile = "{profile}"
unit = {unit}
channels = {{ {channels} }}
"""


def adam6015(channels: str, host: str = "nowhere", fields: str = "") -> str:
    """A thermometer module on its own bus."""
    return f"""
[[bus]]
name = "tcp1"
kind = "modbus_tcp"
host = "{host}"
{fields}
[[device]]
name = "adam"
bus = "tcp1"
profile = "advantech_adam6015"
channels = {{ {channels} }}
"""


def short_calibration(method: str) -> str:
    """A control that has models after three hours, which know no lags."""
    return f"""
[talc]
method = "{method}"
[talc.control]
calibration_steps = 36
measurement_interval_steps = 12
[talc.training]
max_na = 0
max_nb = 0
"""


TEXT = MACHINE + rtu_bus() + m7015()


def two_temperatures(path: Path, more: Mapping[str, Mapping[str, object]] | None = None) -> GatewayConfig:
    """A machine with the temperatures `bed` and `column`, whose database is `path`, and more sections."""
    return validate(
        {
            "machine": {"name": "mill"},
            "storage": {"path": str(path)},
            "bus": [{"name": "tcp1", "kind": "modbus_tcp", "host": "nowhere"}],
            "device": [
                {"name": "adam", "bus": "tcp1", "profile": "advantech_adam6015", "channels": {"bed": 0, "column": 1}}
            ],
            **(more or {}),
        }
    )
