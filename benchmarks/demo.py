"""The demo's figures from twenty seeds, to show how much of a single run's figures is chance.

The demo's machine, load case, probing and learner run in simulated time, a few seconds per seed: what the wires carry
is called directly. The checks of a measurement and the latencies of the wires are left out.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from itertools import repeat

import numpy as np

from benchmarks.rows import BenchRow
from drivers.nc import FollowsErrors, NcSnapshot, OperatingMode, ProgramState
from drivers.problems import read_settings
from drivers.sinumerik.make import make_sinumerik
from drivers.sinumerik.settings import SinumerikSettings
from gateway.config.sections import Compensation, Probing
from gateway.control.grid import GridSampler, Instant
from gateway.model.probing import End
from gateway.model.standing import Standing
from gateway.model.text import plain
from gateway.nc.probing.cycle import Probe, probe_of
from gateway.nc.probing.schedule import excess, schedule_of
from gateway.nc.routes import ByErrors
from gateway.nc.slew import Slew
from gateway.reporting.data import ReportData, Truth
from gateway.reporting.figures import Summary, SummaryRow, summary
from simulators.bench.machine import DEMO_TERMS, BenchMachine
from simulators.nc import FollowingTerms, MachineState
from simulators.plant import RADIUS_MM, load_machine
from talc.control import Controller
from talc.frame import Decision, FloatArray, Frame, Measurement
from talc.indicators import reduction
from talc.papers.training import train
from talc.settings import LearnerSettings, TalcSettings

SEEDS = range(1, 21)
DEFAULT = TalcSettings(method="learner")
LEARNER = replace(DEFAULT, learner=LearnerSettings(limit_um=2.5, limit_um_per_m=7.5))
"""As in the demo's configuration."""
SHIPPED_TERMS = replace(DEMO_TERMS, bound_um=Compensation().bound_um)
"""As without a `bound_um`, which is smaller than the demo's."""
HOURS = 72.0
_EPOCH = datetime(2026, 1, 5, 6, tzinfo=UTC)
_TICK_S, _NC_S, _READ_S, _RENEWED_S, _GRID_S = 10, 30, 100, 30, 300
"""Periods of the demo: of a look at a probing cycle, of the NC, of the devices, of the correction and of the grid."""
_TRAVEL_MM = [[-210.0, 210.0], [-210.0, 210.0], [0.0, 250.0]]
_ROUTE = {"route": "errors", "travel_mm": _TRAVEL_MM}
"""From simulators/bench/gateway.toml."""
_STATES = ("spindle_speed", "speed_X", "speed_Y", "speed_A", "speed_C", "coolant")
_STEPS_OF = 18
"""Channels that come in steps of 0.1 K; the others' steps are smaller."""
_PROBING = Probing(armed=True, sphere_radius_mm=RADIUS_MM, poll_s=_TICK_S)
_REQUEST, _VALID_FOR = 60, 62
"""R-parameters of the probing handshake."""
_OWNER, _BEAT, _SILENCE, _WANTED, _PROBED = 93, 94, 95, 100, 120
"""R-parameters of the claim; the first of the nine errors, and of the shift in mm that a cycle held."""


class _TimeByHand:
    """The bench's clock, moved by the loop."""

    def __init__(self) -> None:
        self.now = 0.0

    def monotonic(self) -> float:
        return self.now

    def utc(self) -> datetime:
        return _EPOCH + timedelta(seconds=self.now)

    async def sleep_until(self, monotonic_s: float) -> None:
        raise RuntimeError(f"nothing waits until {monotonic_s} s: no wire runs")


class DemoLoop:
    """The gateway's tasks on one machine, one after the other.

    Parameters
    ----------
    seed: of weather, loads and noise
    hours: of simulated time
    settings: models are trained between two steps, which on a machine takes seconds
    terms: what limits the offsets, on the gateway and on the control
    sent: (T, 9) errors that go to the control after each grid step instead of the controller's; NaN counts as zero
    """

    def __init__(
        self,
        seed: int,
        hours: float,
        settings: TalcSettings = LEARNER,
        terms: FollowingTerms = DEMO_TERMS,
        *,
        sent: FloatArray | None = None,
    ) -> None:
        self._clock = _TimeByHand()
        self._machine = BenchMachine(seed, self._clock, hours, terms)
        self._nck = self._machine.control.nck
        self._channels = load_machine().channels
        names = (*self._channels, "spindle_growth", *_STATES)
        self._names = names
        self._controller = Controller(names, settings, _GRID_S)
        self._plan = schedule_of(_PROBING)
        self._probe: Probe = probe_of(_PROBING)
        self._reference: FloatArray | None = None
        self._cycles: list[FloatArray] = []
        self._number, self._look_from = 0, math.inf
        place = {"url": "opc.tcp://127.0.0.1", "security": "none", "origin_tool_mm": 0.0, "compensation": _ROUTE}
        control = make_sinumerik(read_settings(SinumerikSettings, place), self._clock)  # never connected
        if not isinstance(control, FollowsErrors):
            raise TypeError(f"{type(control).__name__} does not follow the nine errors")
        self._form = ByErrors(control, terms.reach_mm, RADIUS_MM * 1e-3, terms.bound_um)
        self._slew = Slew(
            terms.bound_um,
            terms.slew_um_per_s,
            "zero",
            _NC_S,
            np.zeros((3, 9)),
            0.0,
            together=self._form.together,
        )
        for number, value in ((_SILENCE, math.inf), (_OWNER, 1.0), (_BEAT, 1.0)):
            self._nck.write_r(number, value, 0.0)
        self._sampler = GridSampler(names, _GRID_S)
        self._corrected = np.full(9, np.nan)
        self._finished: Measurement | None = None
        self._decisions: list[Decision] = []
        self._frames: list[Frame] = []
        self._hours, self._sent = hours, sent

    def run(self) -> ReportData:
        """Run all hours, and return the run as the report takes it."""
        for time_s in range(_TICK_S, int(self._hours * 3600) + 1, _TICK_S):
            self._clock.now = float(time_s)
            state = self._machine.control.state()
            self._machine.advance(self._clock.now)
            if time_s % _READ_S == 0:
                self._add(self._channels, self._temperatures())
                self._add(["spindle_growth"], [self._machine.growth()()[0]])
            if time_s % _NC_S == 0:
                self._add(_STATES, _states(state))
                self._compensate(state)
            self._see_to_probing(state)
            if time_s % _GRID_S == 0:
                self._step()
            elif time_s % _RENEWED_S == 0:
                self._follow_inputs()
        return self._data()

    @property
    def frames(self) -> Sequence[Frame]:
        """One frame for each grid step so far."""
        return self._frames

    def _temperatures(self) -> list[float]:
        values = self._machine.temperatures(self._channels)()
        return [round(v, 1 if i < _STEPS_OF else 2) for i, v in enumerate(values)]

    def _add(self, names: Sequence[str], values: Sequence[float]) -> None:
        self._sampler.add_states(dict(zip(names, values, strict=True)), self._clock.now)

    def _follow_inputs(self) -> None:
        """The correction between two grid steps."""
        inputs, valid = self._sampler.present(self._clock.now)
        corrected = self._controller.between(inputs, valid, self._clock.now % _GRID_S / _GRID_S)
        if corrected is not None and self._sent is None:
            self._corrected = corrected

    def _compensate(self, state: MachineState) -> None:
        """Offsets follow the latest correction; while the machine probes they stand still."""
        if not self._decisions or self._number or state.probing:
            return
        now, errors = self._clock.now, np.nan_to_num(self._corrected)
        wanted = self._form.wanted(errors, _where(state), RADIUS_MM * 1e-3)
        step = self._slew.follow(now, wanted)
        for i, value in enumerate(self._form.errors_of(np.array(step.coefficients_um))):
            self._nck.write_r(_WANTED + i, float(value), now)

    def _see_to_probing(self, state: MachineState) -> None:
        now = self._clock.now
        if self._number:
            answer = self._nck.cycle.answer
            if answer.number == self._number and answer.centres_mm:
                self._take(np.array(answer.centres_mm))
        elif self._plan.wanted and now >= self._look_from:
            outlook = self._plan.look(_snapshot(state, self._clock.utc()), now)
            if outlook.standing is Standing.DUE:
                self._plan.asked()
                self._ask()

    def _ask(self) -> None:
        self._number = int(self._nck.cycle.answer.number) + 1
        self._nck.write_r(_VALID_FOR, _PROBING.timeout_s, self._clock.now)
        self._nck.write_r(_REQUEST, float(self._number), self._clock.now)

    def _take(self, centres: FloatArray) -> None:
        """A cycle's result; the reference is the mean of several."""
        self._cycles.append(centres)
        if self._reference is None and len(self._cycles) < _PROBING.reference_cycles:
            self._ask()
            return
        found = np.mean(self._cycles, axis=0)
        self._cycles, self._number = [], 0
        x, y, z = (mm * 1e3 for mm in self._nck.r[_PROBED : _PROBED + 3])
        held_um = (x, y, z)
        if self._reference is None:
            self._reference = found + np.array(held_um) * 1e-3
        result = self._probe.solve(self._probe.deviations_um(found, self._reference, held_um))
        self._finished = Measurement(result.errors, result.sigma)
        self._plan.ended(End.MEASURED, plain(""), self._clock.now)

    def _step(self) -> None:
        measurement, self._finished = self._finished, None
        k = round(self._clock.utc().timestamp() / _GRID_S)
        frame = self._sampler.frame(Instant(k, self._clock.now), measurement)
        decision = self._controller.step(frame)
        self._corrected = decision.corrected if self._sent is None else self._sent[len(self._decisions)]
        self._frames.append(frame)
        self._decisions.append(decision)
        if decision.training is not None:
            self._controller.adopt(train(decision.training))
        self._plan.want(decision.measure, self._clock.now, excess(decision))
        self._look_from = self._clock.now + _GRID_S - _PROBING.lead_s

    def _data(self) -> ReportData:
        k = np.array([frame.k for frame in self._frames])
        start_s = float(k[0]) * _GRID_S
        nothing = np.full(9, np.nan)
        measured = [nothing if f.measurement is None else f.measurement.errors for f in self._frames]
        return ReportData(
            machine="bench",
            fingerprint="",
            versions="",
            step_s=_GRID_S,
            start_utc_s=start_s,
            k=k,
            phases=tuple(d.phase for d in self._decisions),
            predicted=np.array([d.predicted for d in self._decisions]),
            corrected=np.array([d.corrected for d in self._decisions]),
            sigma=np.array([d.sigma for d in self._decisions]),
            limits=np.array([d.limits for d in self._decisions]),
            measured=np.array(measured),
            models=(),
            events=(),
            compensation_s=np.empty(0),
            compensation_um=np.empty((0, 3)),
            input_names=self._names,
            channel_health={},
            cycles=0,
            rejected_cycles=0,
            truth=Truth.of(np.array(self._machine.truth()), start_s),
        )


def demo(seed: int, settings: TalcSettings, terms: FollowingTerms) -> Summary:
    """The figures of one run, as `talc-gateway demo` prints them."""
    return summary(DemoLoop(seed, HOURS, settings, terms).run())


def rows() -> list[BenchRow]:
    """All rows of the table; takes some minutes."""
    with ProcessPoolExecutor() as pool:
        shipped, found, limits = (
            list(pool.map(demo, SEEDS, repeat(settings), repeat(terms)))
            for settings, terms in ((DEFAULT, SHIPPED_TERMS), (LEARNER, DEMO_TERMS), (DEFAULT, DEMO_TERMS))
        )
    return [*_cost(shipped, "all defaults: "), *demo_table(found), *_cost(limits, "default limits: ")]


def demo_table(found: Sequence[Summary]) -> Iterator[BenchRow]:
    """Medians of the runs, and their ranges in brackets."""
    yield from _figures([s.rows for s in found])
    yield from _cost(found)


def _cost(found: Sequence[Summary], before: str = "") -> Iterator[BenchRow]:
    """What is left at the tool, and what it takes."""
    yield from _figures([s.tool for s in found], before)
    yield BenchRow(f"{before}measurements", spread([float(s.measurements) for s in found], 0))
    yield BenchRow(f"{before}productivity Pd, %", spread([s.productivity for s in found], 1))


def _figures(found: Sequence[Sequence[SummaryRow]], before: str = "") -> Iterator[BenchRow]:
    """The figures of one error or direction after the other; found: those of each run."""
    for same in zip(*found, strict=True):
        name, unit = same[0].name, same[0].unit
        for kind, of in (("E_RMS", _e_rms), ("E_PV", _e_pv)):
            figures = [of(r) for r in same]
            without, left = zip(*figures, strict=True)
            less = [reduction(*pair) for pair in figures]
            beside = f"{spread(without)} without; {spread(less, 0)} % less{_apart([r.parts for r in same], of)}"
            yield BenchRow(f"{before}{name}, {kind}, {unit}", spread(left), beside)


def _e_rms(row: SummaryRow) -> tuple[float, float]:
    return row.e_rms, row.compensated_e_rms


def _e_pv(row: SummaryRow) -> tuple[float, float]:
    return row.e_pv, row.compensated_e_pv


def _apart(parts: Sequence[Sequence[SummaryRow]], of: Callable[[SummaryRow], tuple[float, float]]) -> str:
    """The first hour and the rest, as medians; parts: those of each run, which may have none."""
    told = []
    for said, same in zip(("first hour", "after it"), zip(*parts, strict=False), strict=False):
        without, left = np.median([of(row) for row in same], axis=0)
        told.append(f"{said} {left:.2f} of {without:.2f}")
    return f"; {', '.join(told)}" if told else ""


def spread(values: Sequence[float], digits: int = 2) -> str:
    """Median, and range in brackets."""
    return f"{np.median(values):.{digits}f} ({min(values):.{digits}f} to {max(values):.{digits}f})"


def _where(state: MachineState) -> FloatArray:
    """(5,) X, Y, Z in mm, A and C in radians."""
    at = state.positions
    return np.array([at["X"], at["Y"], at["Z"], math.radians(at["A"]), math.radians(at["C"])])


def _states(state: MachineState) -> list[float]:
    loads = state.loads
    return [loads.spindle, loads.x, loads.y, loads.a, loads.c, float(loads.coolant > 0.5)]


def _snapshot(state: MachineState, utc: datetime) -> NcSnapshot:
    """The snapshot as the driver would read it, as far as the time of probing depends on it."""
    loads = state.loads
    speeds = {"spindle_speed": loads.spindle} | {f"speed_{axis}": getattr(loads, axis.lower()) for axis in "XYZAC"}
    program = {1: ProgramState.INTERRUPTED, 2: ProgramState.STOPPED, 3: ProgramState.RUNNING}[state.program_status]
    return NcSnapshot(
        utc, state.time_s, state.positions, speeds, OperatingMode.AUTO, program, state.tool, alarms=state.alarms
    )
