"""The NC kernel: program, axes, R-parameters, setting data, probing; stepped by time, independent of any protocol."""

import math
from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from simulators.nc.cycle import Centre, CycleSettings, ProbingCycle, ReasonCode
from simulators.nc.main_run import MainRun
from simulators.nc.moves import AXIS_LETTERS, positions_at, probing_loads, probing_positions, tool_at
from simulators.nc.nine_errors import R_COUNT_WITH_ERRORS, ErrorFollower, FollowingTerms
from simulators.nc.nine_errors import R_ECHO as R_ECHO_OF_ERRORS
from simulators.nc.program import LoadCase, MeanLoads
from simulators.nc.watchdog import R_BEAT, R_ECHO, R_OWNER, R_SLOPE_RAMP, R_WATCH, Logged, Watchdog

R_COUNT = 100
"""R-parameters of channel 1: R0 to R99, the control's default."""
R_REQUEST, R_WITHDRAW, R_VALID_FOR, R_DRY_RUN = 60, 61, 62, 63
R_ANSWERS, R_STATE, R_REASON, R_RESULT_OF = 64, 65, 66, 67
R_RESULTS = 70
"""First of eighteen: X, Y, Z of the sphere's centre at each pose, mm."""
R_SPREAD = 88
"""Largest difference between repeated touches, mm."""
R_VERSION = 89
"""Version of the probing program."""
VERSION = 2
"""It knows dry runs."""
R_OFFSETS = 90
"""First of three: shift of the tool in X, Y, Z, mm, when the offsets go over R-parameters."""

CEC_TABLES = ((0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1))
"""Sag compensation tables as TALC_CEC.INI makes them: shifted axis, axis whose position counts; 1 µm per mm from 0."""

JOG, MDA, AUTO = 0, 1, 2
INTERRUPTED, STOPPED, IN_PROGRESS = 1, 2, 3
PROBE_TOOL = 99
_EMERGENCY_STOP = 3000
"""Number of the alarm."""
_CYCLES_OF_AN_ANSWER = 2
REFERENCED, NOT_REFERENCED = 3, 2
"""Values of an axis's reference point status."""


class MachineUnderControl(Protocol):
    """The machine's mechanics, as far as the control is affected by them."""

    def tool_deviation_um(
        self, time_s: float, x_mm: float, y_mm: float, z_mm: float, a_deg: float, c_deg: float
    ) -> tuple[float, float, float]:
        """Thermal deviation (X, Y, Z) in µm of the workpiece side from where the tool meets it, uncompensated.

        If a sphere on the table is 5 µm too far in +X, it is found at +5 µm. The time of a call may be a few seconds
        behind the simulated clock, because touches are processed when the control's loop wakes.
        """
        ...


@dataclass(frozen=True, slots=True)
class MachineState:
    """What the machine does at one moment."""

    time_s: float
    positions: dict[str, float]
    """X Y Z in mm, A C in degrees, machine coordinates."""
    loads: MeanLoads
    mode: int
    program_status: int
    tool: int
    probing: bool
    alarms: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Interference:
    """What somebody does at the control for some time, and the probing program does not notice."""

    begin_s: float
    end_s: float
    mode: int | None = None
    program_status: int | None = None
    moved: Mapping[str, float] = field(default_factory=dict)
    """Axis to how far it is moved, mm or degrees."""
    tool: int | None = None


class Nck:
    """Everything the control does, as a function of the time handed in.

    Parameters
    ----------
    machine: what the probe touches
    program: the machine's day
    seed: of the probing noise; the draw of a cycle depends on the seed and its start alone, not on how many
        cycles went before
    programs: texts of the programs that run at power on; their synchronised actions are evaluated in each interpolation
        cycle. None: the watchdog of simulators.nc.watchdog, which does what the programs should do, at any time step
    ipo_s: interpolation cycle
    r_count: how many R-parameters the channel has
    errors: the control computes K0 from nine errors, as TALC_ERRORS should, at any time step; not with programs
    """

    def __init__(
        self,
        machine: MachineUnderControl,
        program: LoadCase,
        *,
        cycle: CycleSettings | None = None,
        seed: int = 0,
        compensation_sign: int = -1,
        programs: Sequence[str] = (),
        ipo_s: float = 0.01,
        r_count: int = R_COUNT,
        errors: FollowingTerms | None = None,
    ) -> None:
        self._machine = machine
        self.program = program
        self.cycle_settings = cycle if cycle is not None else CycleSettings()
        self.cycle = ProbingCycle(self.cycle_settings, self._touch, program.next_safe_point)
        self._cycle_loads = probing_loads(self.cycle_settings)
        self._seed = seed
        self._noise = self._again = np.zeros((len(self.cycle_settings.poses_deg), 3))
        self._spread_mm = 0.0
        self._noise_of = math.nan
        self._sign = compensation_sign
        self.r = [0.0] * (r_count if errors is None else max(r_count, R_COUNT_WITH_ERRORS))
        self.version = VERSION
        """What its probing program shows at each safe point; 0: an older one that shows nothing, and always touches."""
        self.r[R_VERSION] = VERSION
        self._called_s = 0.0
        """Next call of TALC_SAFE_POINT that can show the version again."""
        self.k0_mm = [0.0] * 3
        """SD43900 $SA_TEMP_COMP_ABS_VALUE of X, Y, Z."""
        self.slope = [0.0] * 3
        """SD43910 $SA_TEMP_COMP_SLOPE."""
        self.reference_mm = [0.0] * 3
        """SD43920 $SA_TEMP_COMP_REF_POSITION."""
        self.table_weight = [0.0] * len(CEC_TABLES)
        """SD41310 $SN_CEC_TABLE_WEIGHT."""
        offsets = () if errors is not None else ((self.k0_mm, 0), (self.r, R_OFFSETS))
        echo = R_ECHO if errors is None else R_ECHO_OF_ERRORS
        self.watchdog = Watchdog(self.r, offsets, ((self.slope, 1.0), (self.table_weight, 1e3)), echo)
        self._programs, self._ipo_s = programs, ipo_s
        self.main_run = self._started(programs, None)
        """What runs the programs; None without any."""
        self.errors = (
            None
            if errors is None
            else ErrorFollower(
                errors, self.r, self.k0_mm, self._sign, self.watchdog, self._where, lambda: self.tool_length_mm
            )
        )
        self.watched: Callable[[float], None] | None = None
        """Called at the end of each interpolation cycle, and whenever SD43900 is written, with the time."""
        self.advanced: Callable[[float], None] | None = None
        """Called when everything that was due has been processed, and so before what is written, with the time."""
        self.log: list[Logged] = []
        """Every change of SD43900 with its time."""
        self.interference: Interference | None = None
        """Only shown: the cycle goes on."""
        self.mode = AUTO
        self.alarms: tuple[int, ...] = ()
        self.referenced = True
        """Whether the axes have been referenced since power on: before, no offset acts."""
        self.drives_on = True
        self.metric = True
        """MD10240: its basic system is metric."""
        self.tool_length_mm = 0.0
        """Length in force along Z."""
        self.probe_available = True
        self.sphere_present = True
        self.chip_um: dict[int, Centre] = {}
        """By pose: how far a chip under the stylus shifts the centre."""
        self.loose_um = 0.0
        """Standard deviation with which a loose sphere or stylus moves between touches."""
        self.miswritten: dict[int, float] = {}
        """R-parameters that the NC program writes wrongly when it shows a result, and what it writes there."""

    # Time ---------------------------------------------------------------------------------------------------------

    @property
    def next_event_s(self) -> float | None:
        """When `advance` next has something to do."""
        return self.cycle.next_event_s

    def advance(self, now_s: float) -> None:
        """Process what was due until now, and write the cycle's answer to the R-parameters."""
        while (due_s := self.cycle.next_event_s) is not None and due_s < now_s:
            self._run(due_s)
            self.cycle.advance(due_s)
            self._show_answer(due_s)
        self._run(now_s)
        self.cycle.advance(now_s)
        self._show_answer(now_s)
        if self.version and self._called_s <= now_s:
            self.r[R_VERSION] = self.version
        if self.advanced is not None:
            self.advanced(now_s)

    def _run(self, until_s: float) -> None:
        """What the control works out in each of its cycles, until then."""
        if self.main_run is None:
            (self.watchdog if self.errors is None else self.errors).advance(until_s)
            self._note(until_s, ramped=True)
            return
        for time_s in self.main_run.until(until_s):
            self.main_run.tool(self.tool_length_mm)
            self.main_run.cycle(self._where(time_s))
            self._note(time_s, ramped=True)

    def _run_ahead(self, now_s: float) -> None:
        """The next cycles before their time: an answer on the wire takes longer than they do."""
        if self.main_run is not None:
            for _ in range(_CYCLES_OF_AN_ANSWER):
                self.main_run.tool(self.tool_length_mm)
                self.main_run.next_cycle(self._where(now_s))
                self._note(now_s, ramped=True)

    def _where(self, time_s: float) -> list[float]:
        late_s = (2.0 + _CYCLES_OF_AN_ANSWER) * self._ipo_s
        if self.cycle.ended and 0.0 <= time_s - self.cycle.ended[-1][1] < late_s:
            # The interpolation cycle that first sees the end finds the axes where they were.
            time_s -= late_s
        positions = self.state(time_s).positions
        return [positions[axis] for axis in AXIS_LETTERS]

    def _started(self, programs: Sequence[str], now_s: float | None) -> MainRun | None:
        if not self._programs:
            return None
        settings = {
            "SA_TEMP_COMP_ABS_VALUE": self.k0_mm,
            "SA_TEMP_COMP_SLOPE": self.slope,
            "SN_CEC_TABLE_WEIGHT": self.table_weight,
        }
        return MainRun(programs, self.r, settings, AXIS_LETTERS, self._ipo_s, now_s)

    def state(self, time_s: float) -> MachineState:
        """The machine's state at a time until now, or later if no cycle is requested until then."""
        began = self._cycle_at(time_s)
        block = self.program.at(time_s)
        if began is None:
            positions, loads, tool = positions_at(block, time_s), block.loads, tool_at(block, time_s, self.program)
        else:
            raised_mm = self.cycle.raised_mm.get(began, 0.0)
            positions = probing_positions(self.cycle_settings, time_s - began, raised_mm)
            loads, tool = self._cycle_loads, PROBE_TOOL
        status = IN_PROGRESS if block.cutting or began is not None else STOPPED
        shown = MachineState(
            time_s=time_s,
            positions=positions,
            loads=MeanLoads() if self.alarms else loads,
            mode=self.mode,
            program_status=INTERRUPTED if self.alarms else status,
            tool=tool,
            probing=began is not None,
            alarms=self.alarms,
        )
        it = self.interference
        return shown if it is None or not it.begin_s <= time_s < it.end_s else _interfered(shown, it)

    def mean_loads(self, start_s: float, end_s: float) -> MeanLoads:
        """Exact mean of the loads over a past stretch of time. It includes probing cycles, but not stops by alarms."""
        if not end_s > start_s:
            raise ValueError(f"start_s = {start_s}, end_s = {end_s}: expected an end after the start")
        total = self.program.integral(end_s) - self.program.integral(start_s)
        cycle_loads = np.array(self._cycle_loads.as_tuple())
        first = bisect_right(self.cycle.ended, start_s, key=lambda cycle: cycle[1])
        cycles = self.cycle.ended[first:]
        if self.cycle.started_s is not None:
            cycles = [*cycles, (self.cycle.started_s, math.inf)]
        for begin, end in cycles:
            low, high = max(begin, start_s), min(end, end_s)
            if high > low:
                total += cycle_loads * (high - low) - (self.program.integral(high) - self.program.integral(low))
        return MeanLoads(*(float(v) for v in total / (end_s - start_s)))

    # What the protocol side writes -----------------------------------------------------------------------------------

    def write_r(self, number: int, value: float, now_s: float) -> None:
        """Set an R-parameter; the handshake's own ones take effect."""
        self.advance(now_s)
        if number == R_WATCH:
            return  # the watchdog owns it and writes it again in its next cycle
        other, self.r[number] = value != self.r[number], value
        if number == R_OWNER:
            self._run(now_s)  # the silence of a gateway that leaves begins now
        elif number == R_BEAT and other:
            if self.main_run is None:
                self.watchdog.beat(now_s)
            else:
                self._run_ahead(now_s)
        elif number == R_VERSION:
            self._called_s = self.cycle.next_safe_point(now_s)
        elif number == R_REQUEST and value > 0 and value != self.cycle.answer.number:
            valid_for, raised_mm = self.r[R_VALID_FOR], max(0.0, self.r[R_DRY_RUN])
            if self.version != VERSION:
                raised_mm = 0.0  # an older program, which touches whatever the parameter says
            self.cycle.ask(now_s, int(value), valid_for if valid_for > 0 else math.inf, raised_mm)
        elif number == R_WITHDRAW and value > 0:
            self.cycle.withdraw(now_s, int(value))
        self._show_answer(now_s)

    def write_k0(self, axis: int, value_mm: float, now_s: float) -> None:
        """Set SD43900 of X, Y or Z (0, 1, 2)."""
        self.advance(now_s)
        self.k0_mm[axis] = value_mm
        self._note(now_s, ramped=False)

    def write_setting(self, values: list[float], index: int, value: float, now_s: float) -> None:
        """Set one of SD43910, SD43920 or SD41310."""
        self.advance(now_s)
        values[index] = value
        self._note(now_s, ramped=False)

    def power_on(self, now_s: float, *, started: bool = True) -> None:
        """Switch off and on again. R-parameters and setting data keep their values, no static action is active, no axis
        is referenced. Then the programs begin, which remove the offsets and forget the gateway.

        started: False: PROG_EVENT did not call them
        """
        self.advance(now_s)
        self.cycle.interrupt(now_s, ReasonCode.STOPPED)
        self.watchdog.runs = started
        if self._programs:
            self.main_run = self._started(self._programs if started else (), now_s)
        elif started:
            self.k0_mm[:] = self.slope[:] = [0.0] * 3
            self.table_weight[:] = [0.0] * len(CEC_TABLES)
            for number in (R_VERSION, *range(R_OFFSETS, R_SLOPE_RAMP + 1)):
                self.r[number] = 0.0
            if self.errors is not None:
                self.errors.power_on(now_s)
        self._called_s = self.cycle.next_safe_point(now_s)
        self.referenced = False
        self._note(now_s, ramped=False)
        self._show_answer(now_s)

    def reset(self, now_s: float) -> None:
        """RESET: ends the program and a cycle in progress. Static actions, R-parameters and setting data stay."""
        self.advance(now_s)
        self.cycle.interrupt(now_s, ReasonCode.STOPPED)
        self.end_program(now_s)

    def end_program(self, now_s: float) -> None:
        """M30."""
        self.advance(now_s)
        if self.main_run is not None:
            self.main_run.reset()
        self._show_answer(now_s)

    def reference(self, now_s: float) -> None:
        """The axes have found their reference points."""
        self.advance(now_s)
        self.referenced = True

    def emergency_stop(self, now_s: float) -> None:
        """Drives off; offsets stay as they are. Ends with `clear_alarms`."""
        self.raise_alarm(_EMERGENCY_STOP, now_s)

    def raise_alarm(self, number: int, now_s: float) -> None:
        """An alarm stops the program and a cycle in progress."""
        self.advance(now_s)
        self.alarms = (*self.alarms, number)
        self._inhibit(now_s)

    def clear_alarms(self, now_s: float) -> None:
        """Acknowledge all alarms; the program continues."""
        self.advance(now_s)
        self.alarms = ()
        self._inhibit(now_s)

    def set_probe_available(self, available: bool, now_s: float) -> None:
        """Whether the magazine holds a probe that answers."""
        self.advance(now_s)
        self.probe_available = available
        self._inhibit(now_s)

    def set_mode(self, mode: int, now_s: float) -> None:
        """JOG, MDA or AUTO; the cycle runs in AUTO only."""
        self.advance(now_s)
        self.mode = mode
        self._inhibit(now_s)

    # Compensation ----------------------------------------------------------------------------------------------------

    def shift_um(self, positions_mm: Centre) -> Centre:
        """The control's shift of the tool: the sum of SD43900-43920, sag tables and R-parameters, µm.

        Position-dependent form: K = K0 + tanβ (P - P0) per axis; a sag table adds its value times its weight
        (Function Manual Extended Functions, K3).
        """
        if not self.referenced:
            return 0.0, 0.0, 0.0
        shift = []
        for axis, position in enumerate(positions_mm):
            value_mm = self.k0_mm[axis] + self.slope[axis] * (position - self.reference_mm[axis])
            for weight, (shifted, over) in zip(self.table_weight, CEC_TABLES, strict=True):
                value_mm += weight * positions_mm[over] * 1e-3 if shifted == axis else 0.0
            shift.append((self._sign * value_mm + self.r[R_OFFSETS + axis]) * 1e3)
        return shift[0], shift[1], shift[2]

    def shift_then_um(self, then: MachineState) -> Centre:
        """The shift at the axes' positions of a past moment, with the offsets that are in force now."""
        x, y, z, a, c = (then.positions[axis] for axis in AXIS_LETTERS)
        if self.errors is None or not self.referenced:
            return self.shift_um((x, y, z))
        found = self.errors.held_um if then.probing else self.errors.shift_um((x, y, z, a, c))
        return float(found[0]), float(found[1]), float(found[2])

    def _note(self, now_s: float, *, ramped: bool) -> None:
        if self.watched is not None:
            self.watched(now_s)
        x, y, z = self.k0_mm
        if (x, y, z) != (self.log[-1].values_mm if self.log else (0.0, 0.0, 0.0)):
            self.log.append(Logged(now_s, (x, y, z), ramped))

    def _inhibit(self, now_s: float) -> None:
        if self.alarms:
            reason = ReasonCode.ALARM
        elif not self.probe_available:
            reason = ReasonCode.NO_PROBE
        elif self.mode != AUTO:
            reason = ReasonCode.WRONG_MODE
        else:
            reason = ReasonCode.NONE
        self.cycle.inhibit(now_s, reason)
        self._show_answer(now_s)

    def _show_answer(self, now_s: float) -> None:
        answer = self.cycle.answer
        if answer.centres_mm:
            self.r[R_RESULTS : R_RESULTS + 3 * len(answer.centres_mm)] = [v for c in answer.centres_mm for v in c]
            self.r[R_SPREAD] = self._spread_mm
            for number, value in self.miswritten.items():
                self.r[number] = value
        self.r[R_RESULT_OF] = answer.number if answer.centres_mm else 0
        self.r[R_ANSWERS], self.r[R_STATE], self.r[R_REASON] = answer.number, answer.state, answer.reason
        if self.errors is not None:
            self.errors.advance(now_s)

    def _touch(self, time_s: float, pose: int, raised_mm: float) -> Centre | None:
        nominal = self.cycle_settings.nominal_centre_mm(pose)
        if raised_mm:
            self._spread_mm = 0.0
            return nominal[0], nominal[1], nominal[2] + raised_mm
        if not self.sphere_present:
            return None
        deviation = self._machine.tool_deviation_um(time_s, *nominal, *self.cycle_settings.poses_deg[pose])
        shift, noise = self.shift_um(nominal), self._noise_um()[pose]
        chip = self.chip_um.get(pose, (0.0, 0.0, 0.0))
        # Every point is touched twice; the second touch only confirms the first.
        apart = float(np.max(np.abs(self._again[pose] - noise))) * 1e-3
        self._spread_mm = apart if pose == 0 else max(self._spread_mm, apart)
        x, y, z = (
            at + (found - added + error + stuck) * 1e-3
            for at, found, added, error, stuck in zip(nominal, deviation, shift, noise, chip, strict=True)
        )
        return x, y, z

    def _noise_um(self) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
        started = self.cycle.started_s if self.cycle.started_s is not None else 0.0
        if self._noise_of != started:
            self._noise_of = started
            draw = np.random.default_rng([self._seed, round(started * 1e3)])
            size = (len(self.cycle_settings.poses_deg), 3)
            self._noise = draw.normal(0.0, self.cycle_settings.noise_um, size)
            self._again = draw.normal(0.0, self.cycle_settings.noise_um, size)
            if self.loose_um > 0:
                self._noise = self._noise + draw.normal(0.0, self.loose_um, size)
                self._again = self._again + draw.normal(0.0, self.loose_um, size)
        return self._noise

    def _cycle_at(self, time_s: float) -> float | None:
        """Start of the cycle in progress at a time."""
        started = self.cycle.started_s
        if started is not None and time_s >= started:
            return started
        index = bisect_right(self.cycle.ended, time_s, key=lambda cycle: cycle[0]) - 1
        if index >= 0 and time_s < self.cycle.ended[index][1]:
            return self.cycle.ended[index][0]
        return None


def _interfered(shown: MachineState, it: Interference) -> MachineState:
    return replace(
        shown,
        positions={axis: at + it.moved.get(axis, 0.0) for axis, at in shown.positions.items()},
        mode=shown.mode if it.mode is None else it.mode,
        program_status=shown.program_status if it.program_status is None else it.program_status,
        tool=shown.tool if it.tool is None else it.tool,
    )
