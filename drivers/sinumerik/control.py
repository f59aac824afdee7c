"""SINUMERIK over OPC UA: snapshot, probing handshake through R-parameters, compensation through setting data."""

import math
from typing import Final

from drivers.base import BadAnswer, Clock, Quality, Refused, WrongDevice
from drivers.nc import (
    AXES,
    NcSnapshot,
    OperatingMode,
    ProbingState,
    ProgramState,
    RequestStatus,
    Triple,
    WatchdogTerms,
    check_height,
    check_number,
    check_offsets,
)
from drivers.opcua.session import OpcUaNumber, OpcUaSession
from drivers.sinumerik.handshake import FINAL, PROBING_REASONS, PROBING_STATES, UNDER_WAY
from drivers.sinumerik.lease import SinumerikLease
from drivers.sinumerik.numbers import code_of, finite_numbers, given_numbers
from drivers.sinumerik.settings import SinumerikSettings
from drivers.text import Text

_RIGHTS: Final = {
    "_SEA_ACX": "Sea",
    "_TEA_ACX": "Tea",
    "_N_NC_GD": "Gud",
    "_N_CH_GD": "Gud",
    "linShift": "Frame",
    "/Plc/": "Plc",
    "/Channel/": "State",
    "/Bag/": "State",
    "/Nck/": "State",
}
"""Part of a node's name, and the right it needs; Read or Write is added to it (manual, list of rights)."""

_MODES: Final = {0: OperatingMode.JOG, 1: OperatingMode.MDA, 2: OperatingMode.AUTO}
_PROGRAM_STATES: Final = {
    1: ProgramState.INTERRUPTED,
    2: ProgramState.STOPPED,
    3: ProgramState.RUNNING,
    4: ProgramState.WAITING,
    5: ProgramState.ABORTED,
}
_SAME_MM: Final = 1e-6
_EMERGENCY_STOP: Final = 3000
"""Alarm while an emergency stop is pressed or not yet acknowledged."""
_KNOWS_DRY_RUNS: Final = 2
"""Version of TALC_SAFE_POINT that does."""
_DRY: Final = -1.0
"""In place of the version, with the request: the program refuses it if another program has taken its height away."""


class Sinumerik:
    """One control. Construction validates and uses no network; see NumericalControl for the operations.

    Every operation raises a DriverError: ConnectError and NoAnswer mean that the session is closed and `connect` is
    needed.
    """

    def __init__(self, settings: SinumerikSettings, clock: Clock) -> None:
        self._settings = settings
        self._clock = clock
        self._session = OpcUaSession(settings, settings.device, _RIGHTS, settings.namespace_uri, settings.session_s)
        paths = settings.nodes
        self._positions = tuple(
            settings.in_channel(paths.position).format(n=settings.axis_numbers[axis]) for axis in AXES
        )
        self._states = settings.state_sources
        names = ("mode", "program", "tool", "tool_length", "probe_in_spindle", "drives_on", "metric")
        named = {name: getattr(paths, name) for name in names if name != "metric" or settings.writes or settings.asks}
        self._named = {name: settings.in_channel(path) for name, path in named.items() if path}
        state_paths = (source.path for source in self._states.values())
        self._referenced = settings.linear(paths.referenced) if paths.referenced else ()
        self._snapshot = (
            *self._positions,
            *state_paths,
            *self._named.values(),
            *self._referenced,
        )
        self._tool_mm = 0.0
        """By how much the tool in use is longer than the one of the origin."""
        self._alarms = paths.alarms  # the control's manual requires a separate request
        hand = settings.handshake
        self._status = tuple(settings.r(n) for n in (hand.request, hand.answers, hand.state, hand.reason))
        results = range(hand.results, hand.results + 3 * settings.poses)
        self._height, self._shown = settings.r(hand.dry_run), settings.r(hand.version)
        # A separate request: a control may not report changes of its R-parameters.
        self._probing = (settings.r(hand.state), self._shown)
        self._request = (*self._status, settings.r(hand.withdraw))
        self._asked = (*(settings.r(n) for n in (hand.request, hand.withdraw, hand.valid_for)), self._height)
        self._shown_version: OpcUaNumber | None = None
        self._heights: dict[int, float] = {}
        """Number of the last request to the height that it was asked with."""
        self._unproven: int | None = None
        """Number of a dry run that the control does not know of yet, because its program has not shown its version."""
        told = (hand.result_of, *results, hand.spread)
        self._result = (*self._status, *(settings.r(n) for n in told), self._height, self._shown)
        self._offsets, self._in_force = settings.offset_nodes, settings.in_force_nodes
        lease = settings.lease
        self._lease = SinumerikLease(self._session, settings)
        self._leased = tuple(settings.r(n) for n in (lease.owner, lease.beat, lease.silence, lease.ramp))

    @property
    def late_write_s(self) -> float:
        """Implements ForgetsWrites: the server ends a session that is silent for longer."""
        return self._session.kept_s

    async def connect(self) -> None:
        """Open the session and read everything once that is read or written later, so that a wrong path or a missing
        right shows at once."""
        try:
            await self._session.connect()
            await self._look_at_units()
            for paths in filter(None, (self._snapshot, self._probing, self._alarms)):
                await self._session.read(paths)
                if self._settings.subscribe_s > 0:
                    await self._session.subscribe(paths, self._settings.subscribe_s)
            self._unproven = None
            self._shown_version = (await self._session.read(self._result))[-1]
            await self._session.read(self._in_force)
            if self._settings.asks:
                await self._session.read((*self._asked, *self._request))
            if self._settings.writes:
                await self._session.read((*self._lease.nodes, *self._leased))
        except BaseException:
            await self._session.close()
            raise

    @property
    def runs_dry(self) -> bool | None:
        """Implements RunsDry. What it shows may be old, so no dry run is asked for until the program has shown it
        again; None: no call of TALC_SAFE_POINT has shown anything since power on."""
        shown = self._shown_version
        if shown is None or not math.isfinite(shown) or shown <= 0:
            return None
        return shown == _KNOWS_DRY_RUNS

    async def _look_at_units(self) -> None:
        """Raises WrongDevice for an inch system. A gateway that only reads goes on if it may not read the unit."""
        path = self._settings.nodes.metric
        try:
            [metric] = await self._session.read((path,)) if path else [True]
        except (Refused, WrongDevice):
            if self._settings.writes or self._settings.asks:
                raise
        else:
            self._check_units(metric)

    def _check_units(self, metric: OpcUaNumber | None) -> None:
        if metric is None:
            raise BadAnswer(Text("nc_no_value", path=self._settings.nodes.metric), device=self._settings.device)
        if not metric:
            raise WrongDevice(
                Text("nc_inch", node=self._settings.nodes.metric),
                device=self._settings.device,
                hint=Text("nc_only_metric"),
            )

    async def close(self) -> None:
        await self._session.close()

    async def snapshot(self) -> NcSnapshot:
        """Three requests, or none while the control reports changes. Raises WrongDevice for an inch system, BadAnswer
        for an axis without a finite position; states without a finite value are missing."""
        values = await self._session.latest(self._snapshot)
        probing, self._shown_version = await self._session.latest(self._probing)
        shown = await self._session.latest(self._alarms) if self._alarms else []
        time, monotonic_s = self._clock.utc(), self._clock.monotonic()
        x, y, z, *rotary = self._numbers(self._positions, values[: len(AXES)])
        values = values[len(AXES) :]
        states = {
            name: float(value) / source.divisor
            for (name, source), value in zip(self._states.items(), values, strict=False)
            if value is not None and math.isfinite(value)
        }
        values = values[len(self._states) :]
        named = dict(zip(self._named, values, strict=False))
        referenced = values[len(self._named) :]
        if "metric" in self._named:
            self._check_units(named["metric"])  # an operator can switch it while the control runs
        self._look_at_tool(named)
        alarms = tuple(code_of(alarm) for alarm in shown if alarm)
        tool, probe = named.get("tool"), named.get("probe_in_spindle")
        under_way = PROBING_STATES.get(code_of(probing)) in UNDER_WAY
        # Within a cycle no length is in force (D0), and the tool is the origin's: the probe.
        longer = 0.0 if under_way and not named.get("tool_length") else self._tool_mm
        return NcSnapshot(
            time=time,
            monotonic_s=monotonic_s,
            positions=dict(zip(AXES, (*self._from_origin(x, y, z - longer), *rotary), strict=True)),
            states=states,
            mode=_MODES.get(code_of(named.get("mode")), OperatingMode.UNKNOWN),
            program=_PROGRAM_STATES.get(code_of(named.get("program")), ProgramState.UNKNOWN),
            tool=None if tool is None or not math.isfinite(tool) else int(tool),
            probe_in_spindle=None if probe is None or not math.isfinite(probe) else bool(probe),
            alarms=alarms,
            ready=not _may_be_stopped(shown) and _drives(named) and all(map(_is_odd, referenced)),
            probing=under_way,
            quality=Quality.GOOD,
        )

    def _look_at_tool(self, named: dict[str, OpcUaNumber | None]) -> None:
        """Without a length in force (D0) the last one counts. Raises BadAnswer for a length that no tool has."""
        length = named.get("tool_length")
        if length is None or not length:
            return
        settings = self._settings
        longer = float(length) - (settings.origin_tool_mm or 0.0)
        if not abs(longer) <= settings.tool_range_mm:
            raise BadAnswer(
                Text(
                    "nc_tool_long",
                    node=settings.nodes.tool_length,
                    length=length,
                    longer=longer,
                    most_mm=settings.tool_range_mm,
                ),
                device=settings.device,
                hint=Text("nc_correct_origin"),
            )
        self._tool_mm = longer

    async def request_probing(self, number: int, dry_run_mm: float = 0.0) -> None:
        """Raises ValueError for a number outside 1 .. 2**31 - 1 or a height outside 0 .. 1000 mm, Refused when the
        control saw this number last or has another request pending."""
        check_number(number, "request number")
        check_height(dry_run_mm)
        await self._check_free(number)
        self._heights, self._unproven = {number: dry_run_mm}, None
        if dry_run_mm:
            # R-parameters outlast power off and an exchange of the programs. Only a call of TALC_SAFE_POINT sets this
            # one again: before, the control gets no number, on which an older program would touch.
            self._check_version(*await self._session.read((self._shown,)))
            await self._session.write({self._shown: 0.0})
            self._unproven = number
        else:
            await self._ask(number)

    async def _check_free(self, number: int) -> None:
        found = self._numbers(self._request, await self._session.read(self._request))
        request, answers, state, _, taken_back = found
        if number in (request, answers):
            raise Refused(
                Text("nc_number_again", number=number),
                device=self._settings.device,
                hint=Text("nc_higher_number"),
            )
        if PROBING_STATES.get(code_of(state)) in UNDER_WAY:
            raise self._busy(Text("nc_cycle_runs", number=answers))
        if request > 0 and request not in (answers, taken_back):
            raise self._busy(Text("nc_request_waits", number=request))

    async def _ask(self, number: int) -> None:
        """Raises BadAnswer when the control does not keep the height: a dry run must not touch, and a cycle must."""
        height, hand = self._heights[number], self._settings.handshake
        values = {self._settings.r(hand.valid_for): hand.request_valid_for_s, self._height: height}
        [shown] = await self._session.read((self._shown,))
        if height:
            values[self._shown] = _DRY  # the call that runs it sets it once more
        elif code_of(shown) == _DRY:
            values[self._shown] = 0.0  # a dry run was withdrawn before any call
        await self._session.write(values)
        [found] = self._numbers((self._height,), await self._session.read((self._height,)))
        self._check_height(found, height)
        self._unproven = None
        # The number is written last, in a separate request, because the control acts on it.
        await self._session.write({self._settings.r(hand.request): float(number)})

    def _check_height(self, found: float, asked: float) -> None:
        if not abs(found - asked) <= _SAME_MM:
            raise BadAnswer(
                Text("nc_height", number=self._settings.handshake.dry_run, found=found, asked=asked),
                device=self._settings.device,
                hint=Text("nc_other_program"),
            )

    async def _prove(self, number: int) -> None:
        """Ask for a dry run as soon as the control's program has shown that it knows them."""
        [version] = await self._session.read((self._shown,))
        if version in (0, _DRY):
            return
        self._check_version(version)
        await self._check_free(number)
        await self._ask(number)

    def _check_version(self, version: OpcUaNumber | None) -> None:
        if version != _KNOWS_DRY_RUNS:
            hand = self._settings.handshake
            raise Refused(
                Text("nc_no_dry_runs", number=hand.version, found=version, wanted=_KNOWS_DRY_RUNS),
                device=self._settings.device,
                hint=Text("nc_load_programs"),
            )

    async def probing_status(self, number: int) -> RequestStatus:
        """State of request `number`; idle when the control holds another request and has not answered this one."""
        check_number(number, "request number")
        if self._unproven == number:
            await self._prove(number)
            return RequestStatus(number, ProbingState.REQUESTED)
        request, answers, state, reason = self._numbers(self._status, await self._session.read(self._status))
        if answers != number or not state:
            return RequestStatus(number, ProbingState.REQUESTED if request == number else ProbingState.IDLE)
        known = self._state(state)
        if known not in FINAL:
            return RequestStatus(number, known)
        # The four parameters may be from different moments. A final state no longer changes: read it with the results.
        again = given_numbers(self._result, await self._session.read(self._result), self._settings.device)
        _, answers_again, state_again, reason, result_of, *values, spread, height, version = again
        if answers_again != answers or state_again != state:
            return RequestStatus(number, ProbingState.REQUESTED)
        if known is not ProbingState.DONE:
            return RequestStatus(
                number, known, reason=PROBING_REASONS.get(code_of(reason), Text("nc_reason", reason=reason))
            )
        if result_of != number:
            raise BadAnswer(
                Text("nc_other_results", number=number, result_of=result_of),
                device=self._settings.device,
                hint=Text("nc_results_first"),
            )
        if number in self._heights:  # no dry run is ever taken for a measurement, and no touch for a dry run
            self._check_height(height, self._heights[number])
            if self._heights[number]:
                self._check_version(version)
        centres = tuple(self._from_origin(*values[i : i + 3]) for i in range(0, len(values), 3))
        return RequestStatus(number, known, centres_mm=centres, spread_mm=spread)

    async def withdraw_probing(self, number: int) -> None:
        """Withdraw the request; a running cycle is stopped as soon as the control can."""
        check_number(number, "request number")
        if self._unproven == number:
            self._unproven = None  # the control does not know of it
        elif not await self._would_count_again(number):
            await self._session.write({self._settings.r(self._settings.handshake.withdraw): float(number)})

    async def _would_count_again(self, number: int) -> bool:
        """Whether another request waits that is withdrawn: there is one number for that, and without its own the
        control would obey it. Only the cycle that runs is more urgent."""
        found = await self._session.read(self._request)
        request, answers, state, _, taken_back = map(code_of, found)
        if request in (number, answers) or request != taken_back:
            return False
        return not (answers == number and PROBING_STATES.get(state) in UNDER_WAY)

    async def write_compensation(self, offsets_um: tuple[float, float, float]) -> None:
        """Raises NotSendable, before anything is sent, for a number that is not finite or beyond `largest_um`.

        On Refused some of the three may have been set: read back.
        """
        comp = self._settings.compensation
        check_offsets(offsets_um, comp.largest_um)
        values = {
            path: comp.sign(axis) * offset * 1e-3
            for axis, (path, offset) in enumerate(zip(self._offsets, offsets_um, strict=True))
        }
        await self._session.write(values)

    async def read_compensation(self) -> tuple[float, float, float]:
        """K0 + tanβ (P - P0), with whatever slope is set on the control (K3); route `r`: the parameters."""
        values = self._numbers(self._in_force, await self._session.read(self._in_force))
        if self._settings.compensation.route != "r":
            k0, slope, reference, position = (values[i : i + 3] for i in (0, 3, 6, 9))
            values = [k + t * (p - p0) for k, t, p0, p in zip(k0, slope, reference, position, strict=True)]
        x, y, z = (self._settings.compensation.sign(axis) * value * 1e3 for axis, value in enumerate(values))
        return x, y, z

    async def try_writing(self) -> None:
        """Implements TriesWriting: the same values again are no new request and no beat, and move nothing."""
        if holder := await self._lease.holder():
            raise Refused(
                Text("nc_held", holder=holder),
                device=self._settings.device,
                hint=Text("nc_stop_first"),
            )
        for paths in self._writable:
            found = self._numbers(paths, await self._session.read(paths))
            await self._session.write(dict(zip(paths, found, strict=True)))

    @property
    def _writable(self) -> tuple[tuple[str, ...], ...]:
        """Everything that this gateway writes, one request each."""
        return self._asked, self._leased, self._offsets

    async def claim(self, owner: int, terms: WatchdogTerms, predecessor: int | None = None) -> None:
        """Raises ValueError for an owner outside 1 .. 2**31 - 1."""
        await self._lease.claim(owner, self._watchdog_values(terms), predecessor)

    async def heartbeat(self, owner: int) -> bool:
        """Raises ValueError like `claim`. False also unless this beat, like the one before it, passes through the
        control's program."""
        return await self._lease.heartbeat(owner)

    async def release(self, owner: int) -> None:
        await self._lease.release(owner)

    def _watchdog_values(self, terms: WatchdogTerms) -> dict[str, float]:
        lease, r = self._settings.lease, self._settings.r
        return {r(lease.silence): terms.silence_s, r(lease.ramp): terms.ramp_um_per_s * 1e-3}

    def _busy(self, what: str) -> Refused:
        hand = self._settings.handshake
        hint = Text("nc_other_probing", number=hand.withdraw)
        return Refused(what, device=self._settings.device, hint=hint)

    def _from_origin(self, x: float, y: float, z: float) -> Triple:
        """Machine coordinates converted to the gateway's."""
        x0, y0, z0 = self._settings.origin_mm
        return x - x0, y - y0, z - z0

    def _state(self, value: float) -> ProbingState:
        state = PROBING_STATES.get(code_of(value))
        if state is None:
            raise BadAnswer(Text("nc_state", value=value), device=self._settings.device)
        return state

    def _numbers(self, paths: tuple[str, ...], values: list[OpcUaNumber | None]) -> list[float]:
        return finite_numbers(paths, values, self._settings.device)


def _may_be_stopped(shown: list[OpcUaNumber | None]) -> bool:
    """The list begins with the oldest: if no place is free, or one has no value, further alarms may be hidden."""
    return bool(shown) and (_EMERGENCY_STOP in map(code_of, shown) or None in shown or all(shown))


def _drives(named: dict[str, OpcUaNumber | None]) -> bool:
    return "drives_on" not in named or bool(named["drives_on"])  # a missing value counts as false


def _is_odd(value: OpcUaNumber | None) -> bool:
    code = code_of(value)
    return code > 0 and code % 2 == 1  # a missing value counts as false
