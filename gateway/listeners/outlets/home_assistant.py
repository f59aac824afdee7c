"""Home Assistant's MQTT discovery: which sensors a machine has, under the names that they have in the key space."""

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Final

from gateway.listeners.outlets.outlet import OutletMessage
from gateway.runtime.versions import program_version
from gateway.telemetry.messages import DecisionMessage, ReadingMessage
from talc.names import THERMAL_ERRORS

_UNITS: Final[Mapping[str, tuple[str, str | None]]] = {
    "degC": ("°C", "temperature"),
    "degF": ("°F", "temperature"),
    "K": ("K", "temperature"),
    "mm": ("mm", "distance"),
    "m": ("m", "distance"),
    "um": ("µm", None),
    "V": ("V", "voltage"),
    "mV": ("mV", "voltage"),
    "A": ("A", "current"),
    "mA": ("mA", "current"),
    "W": ("W", "power"),
    "kW": ("kW", "power"),
    "Hz": ("Hz", "frequency"),
    **{unit: (unit, "pressure") for unit in ("Pa", "kPa", "hPa", "bar", "mbar")},
}
"""Unit and device class, where Home Assistant has one; another unit is passed on as it is."""
_RATES: Final = ("EA0C", "EB0C", "EC0C")
"""Errors in µm/m; the others are in µm."""


def discoveries(heard: OutletMessage, prefix: str, root: str, states: Sequence[str]) -> Iterator[tuple[str, bytes]]:
    """Topic and payload of the sensors that a message shows.

    prefix: of discovery
    root: of the machine's topics
    states: topics that all say `online` while the sensors can be believed
    """

    def sensor(name: str, template: str, unit: str | None = None, device_class: str | None = None) -> tuple[str, bytes]:
        identity = f"talc_{heard.machine}_{name}"
        config = {
            "name": name,
            "unique_id": identity,
            "state_topic": f"{root}/{heard.suffix}",
            "value_template": template,
            "availability": [{"topic": topic} for topic in states],
            "availability_mode": "all",
            "origin": {"name": "talc-gateway", "sw_version": program_version()},
            "device": {"identifiers": [f"talc_{heard.machine}"], "name": heard.machine, "model": "talc-gateway"},
        }
        if unit is not None:
            config |= {"unit_of_measurement": unit, "state_class": "measurement"}
        if device_class is not None:
            config["device_class"] = device_class
        return f"{prefix}/sensor/talc_{heard.machine}/{name}/config", json.dumps(config, ensure_ascii=False).encode()

    match heard.message:
        case ReadingMessage(channel=channel, unit=unit):
            shown, device_class = _UNITS.get(unit, (unit, None))
            yield sensor(channel, "{{ value_json.value }}", None if unit == "1" else shown, device_class)
        case DecisionMessage():
            yield sensor("phase", "{{ value_json.phase }}")
            for error in THERMAL_ERRORS:
                unit = "µm/m" if error in _RATES else "µm"
                yield sensor(f"{error}_corrected", f"{{{{ value_json.corrected.{error} }}}}", unit)
        case _:
            pass
