"""What one field cannot know alone: names used twice, addresses shared, references to nothing."""

import re
from collections import Counter
from collections.abc import Iterable, Iterator

from gateway.config.buses import Bus, CanopenBus, MeRs485Bus, ModbusRtuBus
from gateway.config.model import GatewayConfig
from gateway.config.problems import Problem, suggestion

_UNITS = {"modbus_rtu": (1, 247), "modbus_tcp": (0, 255), "canopen": (1, 127), "me_rs485": (1, 126)}
"""Addresses that the protocols allow (Modbus over serial line V1.02 §2.2; CiA 301 §7.2)."""
_UNSTABLE_PORT = re.compile(r"/dev/tty(USB|ACM)\d+")


def problems_between(config: GatewayConfig) -> list[Problem]:
    """Everything that does not fit together."""
    return [
        *_repeated("bus", (bus.name for bus in config.buses)),
        *_repeated("device", (device.name for device in config.devices)),
        *_inputs(config),
        *_places(config),
        *_addresses(config),
        *_limits(config),
        *_control(config),
    ]


def cautions(config: GatewayConfig) -> list[Problem]:
    """What works today and may not tomorrow."""
    found = []
    for bus in config.buses:
        field, port = _serial_port(bus)
        if port is not None and _UNSTABLE_PORT.fullmatch(port):
            found.append(
                Problem(
                    f"bus '{bus.name}', {field}",
                    f"'{port}' may name another adapter after a reboot; use its name in /dev/serial/by-id",
                )
            )
    return found


def _serial_port(bus: Bus) -> tuple[str, str | None]:
    if isinstance(bus, ModbusRtuBus | MeRs485Bus):
        return "port", bus.port
    if isinstance(bus, CanopenBus) and bus.interface == "slcan":
        return "channel", bus.channel
    return "", None


def _repeated(section: str, names: Iterable[str]) -> Iterator[Problem]:
    for name, count in Counter(names).items():
        if count > 1:
            yield Problem(f"{section} '{name}'", f"name is used {count} times; each {section} needs its own")


def _inputs(config: GatewayConfig) -> Iterator[Problem]:
    if not config.devices:
        yield Problem("[[device]]", "missing; without a device there is nothing to learn from")
    first: dict[str, str] = {}
    for device in config.devices:
        by_index: dict[int | str, str] = {}
        for name, index in device.channels.items():
            where = f"device '{device.name}', channels.{name}"
            if name in first:
                yield Problem(where, f"duplicate channel; {first[name]} has this name already")
            first.setdefault(name, f"device '{device.name}'")
            if index in by_index:
                yield Problem(where, f"channel {index!r} is already '{by_index[index]}'")
            by_index.setdefault(index, name)
    for state in config.states:
        if state.name in first:
            yield Problem(f"state '{state.name}'", f"duplicate input; {first[state.name]} has this name already")
        first.setdefault(state.name, "another state")
    if config.states and config.nc is None:
        yield Problem("[nc]", f"missing; states ({config.states[0].name}, ...) are read from it")


def _places(config: GatewayConfig) -> Iterator[Problem]:
    first: dict[str, str] = {}
    for bus in config.buses:
        if bus.place in first:
            yield Problem(
                f"bus '{bus.name}'", f"{bus.place} is already bus '{first[bus.place]}'; put the devices there"
            )
        first.setdefault(bus.place, bus.name)


def _addresses(config: GatewayConfig) -> Iterator[Problem]:
    kinds = {bus.name: bus.kind for bus in config.buses}
    first: dict[tuple[str, int], str] = {}
    for device in config.devices:
        kind = kinds.get(device.bus)
        if kind is None:
            yield Problem(
                f"device '{device.name}', bus", f"unknown bus '{device.bus}'; {suggestion(device.bus, kinds)}"
            )
            continue
        if kind not in _UNITS:
            continue
        lowest, highest = _UNITS[kind]
        if not lowest <= device.unit <= highest:
            yield Problem(f"device '{device.name}', unit", f"{device.unit}: expected {lowest} to {highest} on {kind}")
        address = device.bus, device.unit
        if address in first:
            yield Problem(
                f"device '{device.name}', unit",
                f"{device.unit} on bus '{device.bus}' is already device '{first[address]}'",
            )
        first.setdefault(address, device.name)


def _limits(config: GatewayConfig) -> Iterator[Problem]:
    channels = {name for device in config.devices for name in device.channels}
    for name in config.limits:
        if name not in channels:
            yield Problem(f"[limits.{name}]", f"no channel has this name; {suggestion(name, channels)}")


def _control(config: GatewayConfig) -> Iterator[Problem]:
    if config.nc is None and config.probing.armed:
        yield Problem("[probing] armed", "true, but there is no [nc] to ask")
    if config.nc is None and config.compensation.mode == "compensate":
        yield Problem("[compensation] mode", "'compensate', but there is no [nc] to write to")
    step_s = config.grid.step_s
    if config.probing.lead_s > step_s:
        yield Problem("[probing] lead_s", f"{config.probing.lead_s:g}: expected at most the grid step, {step_s:g}")
    if config.compensation.stale_after_s <= step_s:
        yield Problem(
            "[compensation] stale_after_s",
            f"{config.compensation.stale_after_s:g}: expected more than the grid step, {step_s:g}, "
            "or every prediction is stale before the next one",
        )
    for bus in config.buses:
        if bus.period_s > step_s:
            yield Problem(
                f"bus '{bus.name}', period_s", f"{bus.period_s:g}: expected at most the grid step, {step_s:g}"
            )
