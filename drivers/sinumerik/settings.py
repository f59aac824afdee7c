"""Settings of a SINUMERIK control: node names, handshake parameters and compensation route, all adjustable."""

import math
import re
from collections.abc import Iterator, Mapping
from typing import Annotated, Final, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from drivers.base import SetupError
from drivers.nc import AXES, ERRORS, LARGEST_UM, LINEAR_AXES, REQUEST_VALID_FOR_S, ROTARY_AXES, Triple
from drivers.opcua.settings import OpcUaSettings
from drivers.section import NotNegative, Positive, Section, matching, wrong
from drivers.text import Text, shown

_DEGREES_PER_TURN = 360.0
ERROR_TERMS: Final = 7
"""R-parameters in which the control's program states its settings."""
ERROR_STATES: Final = 5
"""R-parameters in which that program keeps what outlasts RESET."""
LONGEST_TOOL_MM: Final = 300.0
"""A tool is longer or shorter than that of the origin by no more than this."""
PAIRS: Final = {
    shifted + over: (LINEAR_AXES.index(shifted), LINEAR_AXES.index(over))
    for shifted in LINEAR_AXES
    for over in LINEAR_AXES
    if shifted != over
}
"""Pairs of axes that a sag compensation table connects: shifted axis, axis whose position counts."""


def _not_zero(value: float) -> float:
    if not value:
        raise ValueError(Text("sinumerik_not_zero", value=value))
    return value


def _plus_or_minus_one(value: int) -> int:
    if value not in (-1, 1):
        raise ValueError(Text("sinumerik_sign", value=value))
    return value


NodePath = Annotated[str, matching(r"(?s)/.*", "sinumerik_a_node")]
NodePathOrNone = Annotated[str, matching(r"(?s)(/.*)?", "sinumerik_node_or_none")]
NumberedPath = Annotated[str, matching(r"/[^{}]*\{n\}[^{}]*", "sinumerik_a_numbered")]
NumberedPathOrNone = Annotated[str, matching(r"(/[^{}]*\{n\}[^{}]*)?", "sinumerik_numbered_or_none")]
RNumber = Annotated[int, Field(ge=0)]
"""Number of an R-parameter."""
Sign = Annotated[int, AfterValidator(_plus_or_minus_one)]


class StateNode(Section):
    """A machine state that the control provides."""

    path: NodePath
    """Node name, such as `/Plc/Q4.0`."""
    divisor: Annotated[float, AfterValidator(_not_zero)] = 1.0
    """Divisor of the node's value."""


class Paths(Section):
    """Node names without a namespace. `{n}` stands for the number of an axis or of an R-parameter."""

    position: NumberedPath = "/Channel/MachineAxis/actToolBasePos[u1,{n}]"
    """Position of a machine axis, mm or degrees, machine coordinates."""
    r_parameter: NumberedPath = "/Channel/Parameter/R[u1,{n}]"
    """R-parameters of the channel that probes."""
    k0: NumberedPath = "/NC/_N_AX_SEA_ACX/$SA_TEMP_COMP_ABS_VALUE[u{n}]"
    """K0 of an axis, SD43900, mm."""
    slope: NumberedPath = "/NC/_N_AX_SEA_ACX/$SA_TEMP_COMP_SLOPE[u{n}]"
    """tanβ of an axis, SD43910."""
    reference: NumberedPath = "/NC/_N_AX_SEA_ACX/$SA_TEMP_COMP_REF_POSITION[u{n}]"
    """P0 of an axis, SD43920, mm."""
    weight: NumberedPath = "/NC/_N_NC_SEA_ACX/$SN_CEC_TABLE_WEIGHT[{n}]"
    """Weight of a sag compensation table, SD41310; `{n}` stands for the table's number from 1 on."""
    mode: NodePathOrNone = "/Bag/State/opMode[u1]"
    """Operating mode: 0 JOG, 1 MDA, 2 AUTO. Empty: not read; likewise for the next two."""
    program: NodePathOrNone = "/Channel/State/progStatus[u1]"
    """State of the program: 1 interrupted, 2 stopped, 3 running, 4 waiting, 5 aborted."""
    tool: NodePathOrNone = "/Channel/State/actTNumber[u1]"
    """Number of the tool in the spindle."""
    tool_length: NodePathOrNone = ""
    """Length of the tool in use along Z, mm, such as `/Channel/State/actToolLength1[u1]`. Empty: not read. With route
    `errors` the program on the control reads it itself then; with the others every tool is taken to have the length
    with which `origin_mm` was found. Not for route `k0_slope`."""
    referenced: NumberedPathOrNone = "/Channel/MachineAxis/refPtStatus[u1,{n}]"
    """Whether X, Y, Z are referenced: an odd number when so. Empty: not read."""
    probe_in_spindle: NodePathOrNone = ""
    """A bit of the machine builder's PLC program, such as `/Plc/M120.1`; there is no standard one."""
    metric: NodePathOrNone = "/NC/_N_NC_TEA_ACX/$MN_SCALING_SYSTEM_IS_METRIC"
    """Whether the control's basic system is metric, MD10240: with an inch system nothing is used and nothing written.
    Needs the right TeaRead. Empty: not read, for a control that is known to be metric."""
    drives_on: NodePathOrNone = ""
    """A bit that is on while the drives are, such as `/Plc/M120.2`; there is no standard one. While it is off no offset
    is written. Empty: not read."""
    alarms: tuple[NodePath, ...] = tuple(f"/Nck/SequencedAlarms/textIndex[{n}]" for n in range(1, 17))
    """Numbers of the NC's alarms, the oldest first, 0 where there is none. When all places are taken, or one has no
    good value, an emergency stop may be among the hidden alarms: no offset is written."""


def default_states(axis_numbers: Mapping[str, int]) -> dict[str, StateNode]:
    """Machine states that every control provides, under the names that models use.

    The control reports rotary axes in degrees per minute; models use 1/min.
    """
    feed = "/Channel/MachineAxis/actFeedRate[u1,{n}]"
    states = {"spindle_speed": StateNode(path="/Channel/Spindle/actSpeed[u1,1]")}
    for axis, number in axis_numbers.items():
        divisor = _DEGREES_PER_TURN if axis in ROTARY_AXES else 1.0
        states[f"speed_{axis}"] = StateNode(path=feed.format(n=number), divisor=divisor)
    return states


class Handshake(Section):
    """R-parameters of the probing handshake (docs/nc.md). The gateway writes the first four, and `version` before a dry
    run; the control writes the others."""

    request: RNumber = 60
    """Number of the request, 1 to 2147483647, never the same twice in a row."""
    withdraw: RNumber = 61
    """Number of a request that is withdrawn. At power on the control withdraws the last one."""
    valid_for: RNumber = 62
    """Seconds within which the cycle must begin, by a timer that `TALC_START` starts at power on: without it a request
    is refused. 0: no limit."""
    dry_run: RNumber = 63
    """Height in mm of a dry run above the sphere; 0: the cycle touches."""
    answers: RNumber = 64
    """Number of the request to which state and reason refer."""
    state: RNumber = 65
    """0 idle, 1 accepted, or over and the tool is changed back, 2 running, 3 done, 4 refused, 5 failed."""
    reason: RNumber = 66
    """Why it was refused or failed (docs/nc.md)."""
    result_of: RNumber = 67
    """Number of the request that the results belong to; 0 while there are none."""
    results: RNumber = 70
    """First of three R-parameters per pose: centre of the sphere, mm; of a dry run the one that the control expects,
    that much higher."""
    spread: RNumber = 88
    """Largest difference between repeated touches in the cycle, mm."""
    version: RNumber = 89
    """Version of TALC_SAFE_POINT, which shows it at each call, also without a request: 2 supports dry runs, 1 does not,
    0 since power on: not shown yet. -1, from the gateway: the request is for a dry run."""
    request_valid_for_s: NotNegative = REQUEST_VALID_FOR_S
    """A control that reaches its safe point later than this refuses: the gateway may be gone by then. 0: no limit."""


class OffsetRoute(Section):
    """How offsets reach the control."""

    route: Literal["k0", "k0_slope", "errors", "r"] = "k0"
    """`k0`: setting data SD43900 of X, Y, Z, acts at once; `k0_slope`: tanβ (SD43910) as well, so that the control
    follows its position by itself; `errors`: the nine errors over R-parameters, from which a program on the control
    (`talc-gateway nc sinumerik-files`) computes SD43900 in each of its own cycles, or `k0` if that program is missing;
    `r`: three R-parameters in mm that the NC program adds."""
    signs: tuple[Sign, Sign, Sign] | None = None
    """+1 if a positive value moves the tool in the positive direction, -1 if in the negative. None: -1, because a
    compensation value states an error to be removed, and +1 for route `r`. Check with a dial gauge (docs/nc.md)."""
    travel_mm: tuple[tuple[float, float], tuple[float, float], tuple[float, float]] | None = None
    """Routes `k0_slope` and `errors`: travel of X, Y, Z in machine coordinates; bound and slew hold over all of it."""
    axis_names: Mapping[str, str] = Field(default_factory=lambda: {"X": "X", "Y": "Y", "Z": "Z", "A": "A"})
    """Route `errors`: identifiers of the machine axes X, Y, Z, A on the control (MD10000), such as `{X = "X1", ...}`.
    None: X, Y, Z and A."""
    synchronised: Mapping[str, str] = Field(default_factory=dict)
    """Route `errors`: identifier of the synchronised axis of a gantry, such as `{X = "X2"}`; it gets the same offset in
    the same cycle. The other routes write one axis after the other, which would set the gantry askew."""
    reference_mm: Triple = (0.0, 0.0, 0.0)
    """Route `k0_slope`: P0 of X, Y, Z (SD43920) and zero of the tables, in machine coordinates."""
    tables: Mapping[str, Annotated[int, Field(ge=0)]] = Field(default_factory=dict)
    """Route `k0_slope`: sag compensation table ($AN_CEC, from 0 on) of each pair of axes, such as `{XY = 0}`: X is
    shifted by Y's position. The gateway follows a pair without a table itself, once per period."""
    table_signs: tuple[Sign, Sign, Sign] | None = None
    """Like `signs`, for the tables; None: the same as `signs`."""
    first_r: RNumber = 90
    """First of the three R-parameters of route `r`."""
    largest_um: Positive = LARGEST_UM
    """No offset beyond this is ever sent, whatever the caller requests: the last defence against a wrong unit."""

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if self.route in ("k0_slope", "errors"):
            self._check_travel()
        elif self.travel_mm is not None:
            raise SetupError(Text("sinumerik_no_travel", route=self.route), field=("travel_mm",))
        if self.route == "k0_slope":
            self._check_slopes()
        elif self.tables:
            raise SetupError(Text("sinumerik_no_tables", route=self.route), field=("tables",))
        if self.route == "errors":
            self._check_names()
        elif self.synchronised:
            raise SetupError(Text("sinumerik_gantry"), field=("synchronised",), hint=Text("sinumerik_use_errors"))
        return self

    def _check_travel(self) -> None:
        if self.travel_mm is None:
            raise SetupError(Text("sinumerik_travel_missing", route=self.route), field=("travel_mm",))
        for axis, (low, high) in zip(LINEAR_AXES, self.travel_mm, strict=True):
            if low >= high:
                raise SetupError(
                    Text("sinumerik_travel_order", axis=axis, low=low, high=high), field=("travel_mm", AXES.index(axis))
                )

    def _check_names(self) -> None:
        if set(self.axis_names) != {*LINEAR_AXES, "A"} or len(set(self.axis_names.values())) != len(self.axis_names):
            raise SetupError(Text("sinumerik_axis_names", value=shown(dict(self.axis_names))), field=("axis_names",))
        taken = [*self.axis_names.values(), *self.synchronised.values()]
        if not set(self.synchronised) <= set(LINEAR_AXES) or len(set(taken)) != len(taken):
            raise SetupError(
                Text("sinumerik_synchronised", value=shown(dict(self.synchronised))), field=("synchronised",)
            )
        for field in ("axis_names", "synchronised"):
            for axis, name in getattr(self, field).items():
                if not re.fullmatch(r"[A-Z][A-Z0-9_]{0,31}", name):
                    raise SetupError(Text("sinumerik_axis_name", value=shown(name)), field=(field, axis))

    def _check_slopes(self) -> None:
        for pair in self.tables:
            if pair not in PAIRS:
                raise SetupError(Text("sinumerik_pair", pair=pair, pairs=tuple(PAIRS)), field=("tables", pair))
        if len(set(self.tables.values())) != len(self.tables):
            raise SetupError(Text("sinumerik_tables", value=shown(dict(self.tables))), field=("tables",))

    def moved_together(self, axis: int) -> tuple[str, ...]:
        """Identifiers of the machine axes that get the offset of X, Y or Z (0, 1, 2)."""
        letter = LINEAR_AXES[axis]
        return self.axis_names[letter], *(name for of, name in self.synchronised.items() if of == letter)

    def table_sign(self, axis: int) -> int:
        """The sign of a sag table that shifts this axis (0, 1, 2: X, Y, Z)."""
        return self.table_signs[axis] if self.table_signs is not None else self.sign(axis)

    def sign(self, axis: int) -> int:
        """The sign of a value that moves this axis (0, 1, 2: X, Y, Z)."""
        if self.signs is not None:
            return self.signs[axis]
        return 1 if self.route == "r" else -1


class LeaseParameters(Section):
    """R-parameters of claim and watchdog (docs/nc.md). The gateway writes all but `echo`, `age` and `state`."""

    echo: RNumber = 68
    """The beat, copied by the last of the program's actions once it has passed through all of them: only a program that
    runs can do so. With route `errors` and its program, `errors.echo` takes its place."""
    age: RNumber = 69
    """The control's own: seconds since that beat."""
    owner: RNumber = 93
    """Number of the gateway that writes offsets, a random one in each run; 0: none."""
    beat: RNumber = 94
    """A different number at every heartbeat."""
    silence: RNumber = 95
    """Seconds without a new beat after which the control considers the gateway dead."""
    state: RNumber = 96
    """Of the watchdog: 0 no beat since power on, 1 alive, 2 silent."""
    ramp: RNumber = 97
    """mm/s towards zero on silence; 0 holds."""
    slope_ramp: RNumber = 98
    """Route `k0_slope`: the same for slopes, mm/mm per second."""


class ErrorParameters(Section):
    """R-parameters of route `errors` (docs/nc.md). The gateway writes `wanted` and `tool`, the control the rest."""

    version: RNumber = 99
    """Version of the program on the control; 0: no program."""
    wanted: RNumber = 100
    """First of the nine errors, µm and µm/m: EY0A, EZ0A, EX0C, EY0C, EZ0T, ER0T, EA0C, EB0C, EC0C."""
    in_force: RNumber = 110
    """First of the nine errors after the slew."""
    echo: RNumber = 119
    """The beat, copied by the last of the program's actions."""
    probed: RNumber = 120
    """First of three: shift of the tool in mm that was held during the last probing cycle."""
    terms: RNumber = 123
    """First of seven: slew in µm/s, radius of ER0T in mm, three bounds in µm, two reaches in mm."""
    kept: RNumber = 130
    """First of five, the program's own: what remains of a step in X, Y, Z, whether the offsets are held, the tool."""
    tool: RNumber = 135
    """By how much the tool in use is longer than the one of `origin_mm`, mm: written by the program, with
    `nodes.tool_length` by the gateway."""
    tool_range: RNumber = 136
    """How much of that the program takes, either way, mm; negative: and it reads the length itself."""


class SinumerikControl(OpcUaSettings):
    """Where a SINUMERIK control is, and the addresses of its variables."""

    subscribe_s: NotNegative = 0.0
    """The control reports changes this often instead of being polled every period; 0 polls. A control that offers no
    subscription, or falls silent, is polled."""
    channel: Annotated[int, Field(ge=1, le=10)] = 1
    """Number of the channel in which the programs run: it takes the place of u1 in node names under `/Channel/`."""
    axis_numbers: Mapping[str, int] = Field(default={"X": 1, "Y": 2, "Z": 3, "A": 4, "C": 5})
    """Number of each machine axis on the control."""
    origin_mm: Triple = (0.0, 0.0, 0.0)
    """Machine coordinates of X, Y, Z at which the tool tip is where A and C meet. Shifts from tilt errors grow with the
    distance from there."""
    origin_tool_mm: float | None = None
    """Length of the tool with which `origin_mm` was found, mm; 0: without a tool. Required with route `errors`;
    otherwise used only with `nodes.tool_length`, and 0 then if it is missing."""
    nodes: Paths = Paths()
    handshake: Handshake = Handshake()
    lease: LeaseParameters = LeaseParameters()
    errors: ErrorParameters = ErrorParameters()
    compensation: OffsetRoute = OffsetRoute()

    @model_validator(mode="after")
    def _every_axis(self) -> Self:
        wanted = set(AXES)
        numbers = list(self.axis_numbers.values())
        if set(self.axis_numbers) != wanted or len(set(numbers)) != len(wanted) or min(numbers) < 1:
            raise wrong(Text("sinumerik_axis_numbers", value=shown(dict(self.axis_numbers))), "axis_numbers")
        return self

    @model_validator(mode="after")
    def _tool_or_slopes(self) -> Self:
        if self.nodes.tool_length and self.compensation.route == "k0_slope":
            raise SetupError(Text("sinumerik_no_tool_length"), field=("nodes", "tool_length"))
        if self.origin_tool_mm is None and self.compensation.route == "errors":
            raise SetupError(
                Text("sinumerik_no_origin_tool"),
                field=("origin_tool_mm",),
                hint=Text("sinumerik_origin_tool"),
            )
        return self


class SinumerikSettings(SinumerikControl):
    """One SINUMERIK control, with the states to read from it and the poses of its probing cycle."""

    device: str = "nc"
    """Name in messages."""
    states: Mapping[str, StateNode] | None = None
    """Machine states to read; None: default_states."""
    poses: int = Field(default=6, ge=1)
    """Number of poses that one probing cycle touches."""
    asks: bool = True
    """Whether it may request probing cycles: the control must have all R-parameters of `handshake`."""
    writes: bool = True
    """Whether it may write offsets: the control must have the R-parameters of `lease`."""
    session_s: Positive = 60.0
    """How long the control shall keep the session without a request. A write that the network holds for longer than the
    control agrees to is refused there."""

    @model_validator(mode="after")
    def _check_r_parameters(self) -> Self:
        """No number has two meanings."""
        meaning: dict[int, str] = {}
        for name, number in self.r_numbers():
            if number in meaning:
                raise SetupError(
                    Text("sinumerik_r_twice", number=number, one=meaning[number], other=name),
                    hint=Text("sinumerik_other_r"),
                )
            meaning[number] = name
        return self

    def r_numbers(self) -> Iterator[tuple[str, int]]:
        """Every R-parameter in use, with its meaning; one field may give several."""
        for group in ("handshake", "lease"):
            section = getattr(self, group)
            for field, info in type(section).model_fields.items():
                number = getattr(section, field)
                if field == "results":
                    yield from ((f"{group}.results (of {self.poses} poses)", number + i) for i in range(3 * self.poses))
                elif info.annotation is int:
                    yield f"{group}.{field}", number
        if self.compensation.route == "errors":
            yield "errors.version", self.errors.version
            yield from ((f"errors.{name}", getattr(self.errors, name)) for name in ("echo", "tool", "tool_range"))
            for name, count in (
                ("wanted", ERRORS), ("in_force", ERRORS), ("probed", 3), ("terms", ERROR_TERMS), ("kept", ERROR_STATES)
            ):  # fmt: skip
                first = getattr(self.errors, name)
                yield from ((f"errors.{name} (the first of {count})", first + i) for i in range(count))
        if self.compensation.route == "r":
            yield from (("compensation.first_r (and the next two)", self.compensation.first_r + i) for i in range(3))

    @property
    def state_sources(self) -> Mapping[str, StateNode]:
        states = self.states if self.states is not None else default_states(self.axis_numbers)
        return {name: node.model_copy(update={"path": self.in_channel(node.path)}) for name, node in states.items()}

    def in_channel(self, path: str) -> str:
        """The node name for the configured channel."""
        return re.sub(r"\[u1(?=[,\]])", f"[u{self.channel}", path) if path.startswith("/Channel/") else path

    def r(self, number: int) -> str:
        """Node name of an R-parameter."""
        return self.in_channel(self.nodes.r_parameter).format(n=number)

    @property
    def tool_range_mm(self) -> float:
        """By how much a tool may be longer or shorter than the one of the origin; 0: its length is not read."""
        return LONGEST_TOOL_MM if self.nodes.tool_length or self.compensation.route == "errors" else 0.0

    @property
    def reads_its_tool(self) -> bool:
        """Whether the program on the control reads the length of the tool itself."""
        return self.compensation.route == "errors" and not self.nodes.tool_length

    def linear(self, path: str) -> tuple[str, ...]:
        """Node names of X, Y, Z by a path of `nodes`."""
        return tuple(self.in_channel(path).format(n=self.axis_numbers[axis]) for axis in LINEAR_AXES)

    @property
    def offset_nodes(self) -> tuple[str, ...]:
        """The nodes to which an offset of X, Y, Z is written."""
        if self.compensation.route == "r":
            return tuple(self.r(self.compensation.first_r + i) for i in range(3))
        return self.linear(self.nodes.k0)

    @property
    def table_nodes(self) -> dict[tuple[int, int], str]:
        """Weight of the sag compensation table of each pair (shifted axis, axis whose position counts)."""
        tables = self.compensation.tables
        return {PAIRS[pair]: self.nodes.weight.format(n=table + 1) for pair, table in tables.items()}

    @property
    def in_force_nodes(self) -> tuple[str, ...]:
        """The values that determine the offsets in force: route `r` the parameters; else K0, tanβ, P0, weights,
        positions."""
        if self.compensation.route == "r":
            return self.offset_nodes
        nodes = self.nodes
        form = (p for path in (nodes.k0, nodes.slope, nodes.reference) for p in self.linear(path))
        return (*form, *self.table_nodes.values(), *self.linear(nodes.position))


def error_reach_mm(settings: SinumerikSettings) -> tuple[float, float]:
    """Farthest that the tool gets from where A and C meet, along X and across it, with the longest tool; where the
    program reads its length, with that of the origin. Raises SetupError without travel."""
    if settings.compensation.travel_mm is None:
        raise SetupError(Text("missing_no_default"), field=("compensation", "travel_mm"))
    ends = zip(settings.compensation.travel_mm, settings.origin_mm, strict=True)
    x, y, z = (max(abs(low - zero), abs(high - zero)) for (low, high), zero in ends)
    return x, math.hypot(y, z + (0.0 if settings.reads_its_tool else settings.tool_range_mm))
