"""The wires of a configuration as TOML: buses, devices, and limits of channels."""

import json
from collections.abc import Mapping

from gateway.config.model import GatewayConfig


def wires_toml(
    config: GatewayConfig,
    places: Mapping[str, dict[str, object]] | None = None,
    profiles: Mapping[str, str] | None = None,
) -> str:
    """A complete small configuration without NC, storage and control.

    places: bus to fields to replace, such as another port; None: the field's default
    profiles: profile to its replacement, such as another path
    """
    places, profiles = places or {}, profiles or {}
    parts = [f"[machine]\nname = {toml_value(config.machine.name)}"]
    for bus in config.buses:
        fields = bus.model_dump(mode="json", exclude_defaults=True) | places.get(bus.name, {})
        parts.append("[[bus]]\n" + _pairs({key: value for key, value in fields.items() if value is not None}))
    for device in config.devices:
        fields = device.model_dump(mode="json", exclude={"options", "channels"})
        fields["profile"] = profiles.get(device.profile, device.profile)
        text = "[[device]]\n" + _pairs(fields)
        if device.options:
            text += "\n[device.options]\n" + _pairs(device.options)
        parts.append(f"{text}\n[device.channels]\n" + _pairs(device.channels))
    for channel, limits in config.limits.items():
        parts.append(f"[limits.{channel}]\n" + _pairs(limits.model_dump(mode="json", exclude_none=True)))
    return "\n\n".join(parts) + "\n"


def _pairs(fields: Mapping[str, object]) -> str:
    return "\n".join(f"{key} = {toml_value(value)}" for key, value in fields.items())


def toml_value(value: object) -> str:
    """A text, number or truth value; JSON's form of these is also TOML's, except for one character."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
