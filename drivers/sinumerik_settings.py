"""Where things are on a SINUMERIK control: node names, handshake parameters, compensation route. All replaceable."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Literal

from drivers.base import SetupError
from drivers.nc import LINEAR_AXES, ROTARY_AXES
from drivers.opcua_settings import OpcUaSettings

_DEGREES_PER_TURN = 360.0


@dataclass(frozen=True, slots=True)
class Source:
    """A value on the control: node name and what to divide it by."""

    path: str
    divisor: float = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Paths:
    """Node names without namespace. `{n}` stands for the axis or R-parameter number."""

    position: str = "/Channel/MachineAxis/actToolBasePos[u1,{n}]"
    """Position of a machine axis, mm or degrees, machine coordinates."""
    r_parameter: str = "/Channel/Parameter/R[u1,{n}]"
    k0: str = "/NC/_N_AX_SEA_ACX/$SA_TEMP_COMP_ABS_VALUE[u{n}]"
    """SD43900, mm."""
    slope: str = "/NC/_N_AX_SEA_ACX/$SA_TEMP_COMP_SLOPE[u{n}]"
    """SD43910."""
    reference: str = "/NC/_N_AX_SEA_ACX/$SA_TEMP_COMP_REF_POSITION[u{n}]"
    """SD43920, mm."""
    mode: str = "/Bag/State/opMode[u1]"
    program: str = "/Channel/State/progStatus[u1]"
    tool: str = "/Channel/State/actTNumber[u1]"
    probe_in_spindle: str = "/Plc/M120.1"
    """A bit of the machine builder's PLC program."""
    alarms: tuple[str, ...] = tuple(f"/Nck/SequencedAlarms/textIndex[{n}]" for n in (1, 2, 3))
    """Numbers of the alarms shown, 0 where there is none."""


def default_states(axis_numbers: Mapping[str, int]) -> dict[str, Source]:
    """Machine states under the names that models use.

    The control shows rotary axes in degrees per minute; models take 1/min. The cutting fluid is a bit of the machine
    builder's PLC program.
    """
    feed = "/Channel/MachineAxis/actFeedRate[u1,{n}]"
    states = {"spindle_speed": Source("/Channel/Spindle/actSpeed[u1,1]"), "coolant": Source("/Plc/M120.0")}
    for axis, number in axis_numbers.items():
        divisor = _DEGREES_PER_TURN if axis in ROTARY_AXES else 1.0
        states[f"speed_{axis}"] = Source(feed.format(n=number), divisor)
    return states


@dataclass(frozen=True, slots=True, kw_only=True)
class Handshake:
    """R-parameters of the probing handshake (docs/nc.md). The gateway writes the first three, the control the rest."""

    request: int = 60
    withdraw: int = 61
    valid_for: int = 62
    """Seconds within which the cycle must begin."""
    answers: int = 64
    state: int = 65
    reason: int = 66
    result_of: int = 67
    results: int = 70
    """First of three per pose."""
    poses: int = 6
    request_valid_for_s: float = 900.0
    """A control that reaches its safe point later than this refuses: nobody may be listening any more. 0: no limit."""

    def __post_init__(self) -> None:
        numbers = [self.request, self.withdraw, self.valid_for, self.answers, self.state, self.reason, self.result_of]
        numbers += range(self.results, self.results + 3 * self.poses)
        if self.poses < 1 or min(numbers) < 0 or len(set(numbers)) != len(numbers):
            raise SetupError(f"handshake: R-parameters {numbers} overlap or are below 0")
        if not self.request_valid_for_s >= 0:
            raise SetupError(f"request_valid_for_s = {self.request_valid_for_s!r}: expected 0 or more")


@dataclass(frozen=True, slots=True, kw_only=True)
class Compensation:
    """How offsets reach the control."""

    route: Literal["k0", "r"] = "k0"
    """`k0`: setting data SD43900 of X, Y, Z, acts at once; `r`: three R-parameters in mm that the NC program adds."""
    signs: tuple[int, int, int] | None = None
    """+1 where a positive value moves the tool in plus direction, -1 where in minus. None: -1 for `k0`, as a
    compensation value stands for an error to be taken away, +1 for `r`. Check with a dial gauge (docs/nc.md)."""
    first_r: int = 90
    largest_um: float = 500.0
    """No offset beyond this is ever sent, whoever asks: last line of defence against a wrong unit."""

    def __post_init__(self) -> None:
        if self.route not in ("k0", "r"):
            raise SetupError(f"route = {self.route!r}: expected 'k0' or 'r'")
        if self.signs is not None and sorted({-1, 1, *self.signs}) != [-1, 1]:
            raise SetupError(f"signs = {self.signs!r}: expected three of +1 or -1")
        if self.first_r < 0:
            raise SetupError(f"first_r = {self.first_r!r}: expected 0 or more")
        if not self.largest_um > 0:
            raise SetupError(f"largest_um = {self.largest_um!r}: expected more than 0")

    def sign(self, axis: int) -> int:
        """Of X, Y, Z (0, 1, 2)."""
        if self.signs is not None:
            return self.signs[axis]
        return -1 if self.route == "k0" else 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Lease:
    """R-parameters of claim and watchdog (docs/nc.md). The gateway writes all but `state`."""

    owner: int = 93
    beat: int = 94
    silence: int = 95
    """Seconds without a new beat until the control takes the gateway for dead."""
    state: int = 96
    """0 the watchdog has seen no beat since power on, 1 alive, 2 silent."""
    ramp: int = 97
    """mm/s towards zero on silence; 0 holds."""

    def __post_init__(self) -> None:
        numbers = [self.owner, self.beat, self.silence, self.state, self.ramp]
        if min(numbers) < 0 or len(set(numbers)) != len(numbers):
            raise SetupError(f"lease: R-parameters {numbers} overlap or are below 0")


@dataclass(frozen=True, slots=True, kw_only=True)
class SinumerikSettings(OpcUaSettings):
    """One SINUMERIK control. Raises SetupError naming the field that cannot be."""

    device: str = "nc"
    """Name in messages."""
    axis_numbers: Mapping[str, int] = field(default_factory=lambda: {"X": 1, "Y": 2, "Z": 3, "A": 4, "C": 5})
    """Number of each machine axis on the control."""
    paths: Paths = field(default_factory=Paths)
    subscribe_s: float = 0.0
    """Have the control tell of changes this often instead of asking at every snapshot; 0: ask. A control that offers
    no subscription, or falls silent, is asked."""
    states: Mapping[str, Source] | None = None
    """Machine states to read; None: default_states."""
    handshake: Handshake = field(default_factory=Handshake)
    compensation: Compensation = field(default_factory=Compensation)
    lease: Lease = field(default_factory=Lease)

    def __post_init__(self) -> None:
        OpcUaSettings.__post_init__(self)
        if not self.subscribe_s >= 0:
            raise SetupError(f"subscribe_s = {self.subscribe_s!r}: expected 0 or more")
        wanted = set(LINEAR_AXES + ROTARY_AXES)
        if set(self.axis_numbers) != wanted or len(set(self.axis_numbers.values())) != len(wanted):
            raise SetupError(
                f"axis_numbers = {dict(self.axis_numbers)!r}: expected a different number for each of X Y Z A C"
            )
        for name in ("position", "r_parameter", "k0", "slope", "reference"):
            path = getattr(self.paths, name)
            if not re.fullmatch(r"/[^{}]*\{n\}[^{}]*", path):
                raise SetupError(f"paths.{name} = {path!r}: expected a name beginning with / that holds {{n}} once")
        for name, source in self.state_sources.items():
            if source.divisor == 0 or not source.path.startswith("/"):
                raise SetupError(
                    f"states.{name} = {source!r}: expected a path beginning with / and a divisor that is not 0"
                )

    @property
    def state_sources(self) -> Mapping[str, Source]:
        return self.states if self.states is not None else default_states(self.axis_numbers)

    def with_nodes(self, nodes: Mapping[str, str]) -> "SinumerikSettings":
        """The same control with other node names, by field of Paths or as `states.<name>`.

        Raises SetupError for a name that is neither.
        """
        known = {f.name for f in fields(Paths)} - {"alarms"}
        states, paths = dict(self.state_sources), self.paths
        for name, path in nodes.items():
            state = name.removeprefix("states.")
            if name in known:
                paths = replace(paths, **{name: path})  # type: ignore[arg-type]  # `known` holds the plain names only
            elif name.startswith("states.") and state in states:
                states[state] = replace(states[state], path=path)
            else:
                every = sorted(known | {f"states.{s}" for s in states})
                raise SetupError(f"nodes.{name}: unknown", hint=f"one of {', '.join(every)}")
        return replace(self, paths=paths, states=states)

    def r(self, number: int) -> str:
        """Node name of an R-parameter."""
        return self.paths.r_parameter.format(n=number)
