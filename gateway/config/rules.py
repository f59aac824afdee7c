"""Checks across fields: duplicate names, shared addresses, references to missing sections, profiles and prior."""

import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from drivers.base import SetupError
from drivers.modbus.inputs import addresses_as_in_manuals
from drivers.modbus.profile import ModbusProfile
from drivers.nc import ROTARY_AXES
from drivers.profiles import UserProfile, is_users, user_profile
from gateway.config.controls import Nc, SinumerikNc
from gateway.config.extensions import asked
from gateway.config.metrics import metrics_problems
from gateway.config.model import GatewayConfig
from gateway.config.polled import BusSection
from gateway.config.prior import PriorError, prior_for
from gateway.config.problems import ConfigError, Problem, shown, suggestion
from gateway.config.telemetry_rules import telemetry_cautions, telemetry_problems
from gateway.model.codes import NoticeCode
from gateway.model.text import Text, text_of
from talc.chain import chain_of
from talc.kinematics import CHAIN
from talc.probing import check_poses

_SLOPE_UM_PER_MM = 0.1
"""Slope of a table that has grown by 12 µm at 120 mm, or an axis tilted by 100 µm/m: usual on a warm machine."""
_MOST_CHANNELS = 1000
"""A database has 2047 numbers for channels in its life, and a channel whose unit changes takes another one."""
_SHORTEST_PLANNED_S = 4.3
"""Planned loads are learnt from two days or more, and the most steps that are kept are 40,320."""
_UNSTABLE_PORT = re.compile(r"/dev/tty(USB|ACM)\d+")


def checked(config: GatewayConfig, path: Path) -> GatewayConfig:
    """The configuration with the user's own profiles and the prior. Raises ConfigError with every problem found."""
    config, unreadable = _with_own_profiles(config)
    problems, prior = problems_between(config), None
    try:
        prior = prior_for(config.talc, config.input_names)
    except PriorError as error:
        problems.append(Problem("[talc] prior", text_of(error)))
    if problems or unreadable:
        raise ConfigError(path, problems or unreadable)
    return config.with_prior(prior)


def _with_own_profiles(config: GatewayConfig) -> tuple[GatewayConfig, list[Problem]]:
    """The user's own profiles are read here once, so that what was checked is what runs. Also what cannot be read; a
    device's check reports it with the device."""
    profiles: dict[str, UserProfile] = {}
    unreadable: list[Problem] = []
    others = {bus.name for bus in config.buses if not bus.has_profiles}
    devices = (device for device in config.devices if device.bus not in others)
    for name in dict.fromkeys(device.profile for device in devices if is_users(device.profile)):
        try:
            profiles[name] = user_profile(name)
        except SetupError as error:
            unreadable.append(Problem("", text_of(error)))
    return config.with_profiles(profiles), unreadable


def problems_between(config: GatewayConfig) -> list[Problem]:
    """Every contradiction between sections; only what is wrong with buses of other packages, if that is anything."""
    return list(_answers(config)) or [
        *_repeated("bus", (bus.name for bus in config.buses)),
        *_repeated("device", (device.name for device in config.devices)),
        *_inputs(config),
        *_planned_loads(config),
        *_places(config),
        *_waits(config),
        *_addresses(config),
        *_number_of_channels(config),
        *_limits(config),
        *_asked_of_the_control(config),
        *_chain(config),
        *_control(config),
        *_poses(config),
        *_storage(config),
        *_watchdog(config),
        *_devices(config),
        *_nc(config),
        *telemetry_problems(config.telemetry),
        *metrics_problems(config.metrics, config.telemetry.tls),
    ]


def cautions(config: GatewayConfig) -> list[Problem]:
    """Warnings: settings that work now and may fail later."""
    found = []
    for bus in config.buses:
        field, port = bus.serial_path or ("", "")
        if _UNSTABLE_PORT.fullmatch(port):
            found.append(
                Problem(
                    f"bus '{bus.name}', {field}",
                    Text(NoticeCode.PORT_UNSTABLE, port=port),
                )
            )
        shared = sum(device.bus == bus.name for device in config.devices) > 1
        if shared and not bus.only_listens and bus.timeout_s > bus.period_s:
            found.append(
                Problem(
                    f"bus '{bus.name}', timeout_s",
                    Text(NoticeCode.TIMEOUT_LONG, timeout_s=bus.timeout_s, period_s=bus.period_s),
                )
            )
        found += _cautions_of(f"bus '{bus.name}',", bus)
    if config.prior is not None and config.talc.method != "learner":
        found.append(Problem("[talc] prior", Text(NoticeCode.PRIOR_NO_EFFECT, method=config.talc.method)))
    if config.nc is not None:
        found += _cautions_of("[nc]", config.nc)
    if config.planned_loads and config.grid.step_s < _SHORTEST_PLANNED_S:
        found.append(Problem("[[planned_load]]", Text(NoticeCode.PLANNED_SHORT, least_s=_SHORTEST_PLANNED_S)))
    found += _manuals_addresses(config)
    found += _following(config)
    if config.storage.path.is_relative_to("/etc"):
        found.append(
            Problem(
                "[storage] path",
                Text(NoticeCode.STORE_IN_ETC, path=str(config.storage.path)),
            )
        )
    return [*found, *telemetry_cautions(config.telemetry)]


def _cautions_of(where: str, section: BusSection | Nc) -> list[Problem]:
    try:
        return asked(section.kind, lambda: [Problem(f"{where} {field}", text) for field, text in section.cautions()])
    except SetupError as error:
        return [Problem(where.rstrip(","), error.advice, error.field)]


def _manuals_addresses(config: GatewayConfig) -> Iterator[Problem]:
    """Addresses as manuals number them: a device that does have such an address shows another value there."""
    for device in config.devices:
        profile = config.profile_of(device)
        if isinstance(profile, ModbusProfile):  # the user's own
            for channel, meant in addresses_as_in_manuals(profile, device.channels).items():
                yield Problem(f"device '{device.name}', channels.{channel}", meant)


def _following(config: GatewayConfig) -> Iterator[Problem]:
    """A shift for the present position is held back by the slew, which is meant for heat."""
    nc, slew = config.nc, config.compensation.slew_um_per_s
    if config.compensation.mode != "compensate" or not isinstance(nc, SinumerikNc):
        return
    if nc.compensation.route not in ("k0_slope", "errors"):
        yield Problem(
            "[nc.compensation] route",
            Text(
                NoticeCode.ROUTE_FOLLOWS_SLOWLY,
                route=nc.compensation.route,
                period_s=nc.period_s,
                slew_um_per_s=slew,
                slope=_SLOPE_UM_PER_MM,
                speed=slew / _SLOPE_UM_PER_MM * 60.0,
            ),
        )


def _watchdog(config: GatewayConfig) -> Iterator[Problem]:
    if config.nc is not None and config.compensation.watchdog_s < 4 * config.nc.period_s:
        yield Problem(
            "[compensation] watchdog_s",
            Text(NoticeCode.WATCHDOG_SHORT, watchdog_s=config.compensation.watchdog_s, period_s=config.nc.period_s),
        )


def _repeated(section: str, names: Iterable[str]) -> Iterator[Problem]:
    for name, count in Counter(names).items():
        if count > 1:
            yield Problem(f"{section} '{name}'", Text(NoticeCode.NAME_REPEATED, count=count, section=section))


def _inputs(config: GatewayConfig) -> Iterator[Problem]:
    if not config.devices:
        yield Problem("[[device]]", Text(NoticeCode.NO_DEVICE))
    first: dict[str, str] = {}
    for device in config.devices:
        for name in device.channels:
            where = f"device '{device.name}', channels.{name}"
            if name in first:
                yield Problem(where, Text(NoticeCode.CHANNEL_REPEATED, first=first[name]))
            first.setdefault(name, f"device '{device.name}'")
    for state in config.states:
        if state.name in first:
            yield Problem(f"state '{state.name}'", Text(NoticeCode.INPUT_REPEATED, first=first[state.name]))
        first.setdefault(state.name, "another state")
    stated = [state.name for state in config.states if state.use == "tolerance"]
    if len(stated) > 1:
        yield Problem(f"state '{stated[1]}', use", Text(NoticeCode.TOLERANCE_REPEATED, first=stated[0]))
    if stated and (config.talc.method != "learner" or config.talc.learner.least_limit_um is None):
        yield Problem(f"state '{stated[0]}', use", Text(NoticeCode.TOLERANCE_UNBOUNDED))
    if config.states and config.nc is None:
        yield Problem("[nc]", Text(NoticeCode.NC_OF_STATES, state=config.states[0].name))


def _planned_loads(config: GatewayConfig) -> Iterator[Problem]:
    yield from _repeated("planned_load", (planned.name for planned in config.planned_loads))
    known = config.input_names
    for planned in config.planned_loads:
        for name in planned.loads:
            if name not in known:
                where = f"planned_load '{planned.name}', loads.{name}"
                yield Problem(where, Text(NoticeCode.LOAD_NO_INPUT, advice=suggestion(name, known)))
    if config.planned_loads and config.talc.method != "learner":
        yield Problem("[[planned_load]]", Text(NoticeCode.PLANNED_NO_LEARNER))


def _answers(config: GatewayConfig) -> Iterator[Problem]:
    for bus in config.buses:
        try:
            bus.check_answers(config.devices_of(bus.name))
        except SetupError as error:
            yield Problem(f"bus '{bus.name}'", error.advice, error.field)


def _places(config: GatewayConfig) -> Iterator[Problem]:
    first: dict[str, BusSection] = {}
    for bus in config.buses:
        port = bus.place.rpartition("://")[2].rstrip("/")  # of a device server, however it is spoken to
        if port in first:
            yield Problem(f"bus '{bus.name}'", _what_to_do(bus, first[port]))
        first.setdefault(port, bus)


def _what_to_do(bus: BusSection, first: BusSection) -> Text:
    """With a second bus at the place of the first."""
    if (bus.carries or bus.kind) == (first.carries or first.kind):
        return Text(NoticeCode.BUS_AT_SAME_PLACE, place=bus.place, first=first.name)
    return Text(NoticeCode.BUS_OF_OTHER_KIND, place=bus.place, first=first.name, kind=first.kind)


def _waits(config: GatewayConfig) -> Iterator[Problem]:
    for bus in config.buses:
        if bus.read_limit_s < bus.timeout_s:
            yield Problem(
                f"bus '{bus.name}', read_limit_s",
                Text(NoticeCode.READ_LIMIT_SHORT, read_limit_s=bus.read_limit_s, timeout_s=bus.timeout_s),
            )
        options = (device.options for device in config.devices_of(bus.name))
        if bus.timeout_s > 3.0 * bus.period_s and bus.timeout_is_age(options):
            yield Problem(f"bus '{bus.name}', timeout_s", bus.too_old(bus.timeout_s))


def _addresses(config: GatewayConfig) -> Iterator[Problem]:
    buses = {bus.name: bus for bus in config.buses}
    first: dict[tuple[object, ...], str] = {}
    for device in config.devices:
        if device.bus not in buses:
            yield Problem(
                f"device '{device.name}', bus",
                Text(NoticeCode.UNKNOWN_BUS, bus=device.bus, advice=suggestion(device.bus, buses)),
            )
            continue
        bus = buses[device.bus]
        if bus.units is None:
            continue
        address: tuple[object, ...] = device.bus, device.unit
        if bus.several_per_unit:
            address += device.profile, *sorted(device.options.items())
        if address in first:
            code = NoticeCode.UNIT_SHARED if bus.several_per_unit else NoticeCode.UNIT_TAKEN
            yield Problem(
                f"device '{device.name}', unit",
                Text(code, unit=device.unit, bus=device.bus, first=first[address]),
            )
        first.setdefault(address, device.name)


def _number_of_channels(config: GatewayConfig) -> Iterator[Problem]:
    many = sum(len(device.channels) for device in config.devices)
    if many > _MOST_CHANNELS:
        yield Problem(
            "[[device]]",
            Text(NoticeCode.MANY_CHANNELS, count=many, most=_MOST_CHANNELS),
        )


def _limits(config: GatewayConfig) -> Iterator[Problem]:
    channels = {name for device in config.devices for name in device.channels}
    for name in config.limits:
        if name not in channels:
            yield Problem(f"[limits.{name}]", Text(NoticeCode.LIMITS_NO_CHANNEL, advice=suggestion(name, channels)))


def _asked_of_the_control(config: GatewayConfig) -> Iterator[Problem]:
    nc, armed, writes = config.nc, config.probing.armed, config.compensation.mode == "compensate"
    if nc is None and armed:
        yield Problem("[probing] armed", Text(NoticeCode.ARMED_NO_NC))
    if nc is None and writes:
        yield Problem("[compensation] mode", Text(NoticeCode.COMPENSATES_NO_NC))
    if nc is not None and nc.only_read and armed:
        yield Problem("[probing] armed", Text(NoticeCode.ARMED_ONLY_READ, kind=nc.kind))
    if nc is not None and nc.only_read and writes:
        what = Text(NoticeCode.COMPENSATES_ONLY_READ, kind=nc.kind)
        yield Problem("[compensation] mode", what)


def _chain(config: GatewayConfig) -> Iterator[Problem]:
    """Probing, offsets and every kind of control are for one chain; on another one they would be wrong."""
    machine = config.machine
    if machine.corrected:
        return
    if config.nc is not None and (axes := set(chain_of(machine.chain).rotary)) != set(ROTARY_AXES):
        yield Problem("[nc]", Text(NoticeCode.CONTROL_OTHER_AXES, axes=sorted(axes) or "-", chain=machine.chain))
    if config.probing.armed:
        yield Problem("[probing] armed", Text(NoticeCode.CHAIN_NOT_CORRECTED, value="true", corrected=CHAIN))
    if (mode := config.compensation.mode) != "monitor":
        yield Problem("[compensation] mode", Text(NoticeCode.CHAIN_NOT_CORRECTED, value=mode, corrected=CHAIN))


def _control(config: GatewayConfig) -> Iterator[Problem]:
    step_s = config.grid.step_s
    if config.probing.armed and config.probing.lead_s > step_s:  # nobody else asks for a cycle
        yield Problem("[probing] lead_s", Text(NoticeCode.BEYOND_STEP, value=config.probing.lead_s, step_s=step_s))
    if config.probing.insist_after_s < config.probing.prefer_idle_s:
        yield Problem(
            "[probing] insist_after_s",
            Text(
                NoticeCode.INSIST_EARLY, insist_s=config.probing.insist_after_s, prefer_s=config.probing.prefer_idle_s
            ),
        )
    if config.nc is not None and config.compensation.stale_after_s <= step_s:
        yield Problem(
            "[compensation] stale_after_s",
            Text(NoticeCode.STALE_EARLY, stale_s=config.compensation.stale_after_s, step_s=step_s),
        )
    for bus in config.buses:
        if bus.period_s > step_s:
            yield Problem(
                f"bus '{bus.name}', period_s", Text(NoticeCode.BEYOND_STEP, value=bus.period_s, step_s=step_s)
            )


def _poses(config: GatewayConfig) -> Iterator[Problem]:
    """A pose set may leave some errors undetermined: A = 0 alone finds 7 of 9."""
    probing = config.probing
    if not config.machine.corrected:
        return
    largest = np.abs(probing.poses_deg).max()
    if 0.0 < largest <= 2.0 * np.pi:
        yield Problem("[probing] poses_deg", Text(NoticeCode.POSES_IN_RADIANS, largest=float(largest)))
        return
    poses = np.deg2rad(np.asarray(probing.poses_deg, dtype=float))
    try:
        check_poses(poses, probing.sphere_radius_mm * 1e-3, probing.sphere_height_mm * 1e-3)
    except ValueError as error:
        yield Problem("[probing] poses_deg", str(error))


def _storage(config: GatewayConfig) -> Iterator[Problem]:
    path = config.storage.path
    if os.path.isdir(path):  # noqa: PTH112 - Path.is_dir raises for a program that may not look there, such as the page
        yield Problem("[storage] path", Text("path_no_file", value=shown(str(path))))


def _devices(config: GatewayConfig) -> Iterator[Problem]:
    """What the drivers would reject: profiles, units, channel numbers, options. Uses no network."""
    names = Counter(bus.name for bus in config.buses)
    for bus in config.buses:
        if names[bus.name] == 1:
            yield from bus.problems(config.devices_of(bus.name), config.profile_of)


def _nc(config: GatewayConfig) -> Iterator[Problem]:
    """What the control's driver itself rejects. Uses no network."""
    nc = config.nc
    if nc is None:
        return
    try:
        known = asked(nc.kind, lambda: tuple(nc.known_states()))
    except SetupError as error:
        yield Problem("[nc]", error.advice, error.field)
        return
    channels = {name for device in config.devices for name in device.channels}
    names = [state.name for state in config.states]
    for name in names:
        if name not in known and name not in channels:
            yield Problem(
                f"state '{name}'",
                Text(NoticeCode.UNKNOWN_STATE, advice=suggestion(name, known), other=nc.other_states(name)),
            )
    try:
        nc.settings(config.probing.poses_deg, (name for name in names if name in known))
    except SetupError as error:
        yield Problem("[nc]", error.advice, error.field)
    largest, bound = nc.largest_um, max(config.compensation.bound_um)
    if bound > largest:
        yield Problem(
            "[compensation] bound_um",
            Text(NoticeCode.BOUND_BEYOND_LARGEST, bound=bound, name=nc.largest_is, largest=largest),
        )
