"""Everything that can go wrong between a gateway and a control that compensates, many times, judged by the control's
record.

`python -m tests.benches.nc_disturbances --count 200`: the gateway's link on an emulated SINUMERIK, over OPC UA, which
runs the programs as they are written, one interpolation cycle each 10 ms of simulated time. The axes stand still, so
that every change is the compensation's, in whichever corner of the travel it is largest. The target changes every few
seconds, so that there is always a ramp.
"""

import asyncio
import itertools
import logging
import random
import sys
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import AsyncExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import click
import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from drivers.nc import NumericalControl
from drivers.sinumerik.make import make_sinumerik
from drivers.sinumerik.programs import ErrorTerms, errors_program
from drivers.sinumerik.settings import PAIRS, OffsetRoute, SinumerikSettings
from gateway.config.extended import validate
from gateway.model.notice import Notice
from gateway.nc.link import NcLink
from gateway.nc.problems import DISARMING
from gateway.nc.settings import Earlier, Identity, LinkSettings, Listeners
from gateway.runtime.clocks import RealClock
from simulators.nc import Activity, CycleSettings, DayPart, EmulatedControl, LoadCase, MeanLoads, Nck
from simulators.nc.nck import CEC_TABLES, R_OFFSETS
from simulators.nc.nine_errors import R_COUNT_WITH_ERRORS
from talc.frame import Decision, FloatArray, Phase
from tests.benches.cut_wire import CutWire, wire_to
from tests.benches.emulated_bench import Rigid
from tests.benches.simulated_time import simulated_time
from tests.benches.spoilt_opcua import changes

PERIOD_S, SLEW_UM_PER_S, SILENCE_S, IPO_S = 1.0, 1.0, 4.0, 0.01
BOUND_UM = (50.0, 50.0, 50.0)
KINDS: Final = ("kill", "stop", "cut", "silence", "hang", "late", "malformed")
ROUTES: Final = ("errors", "k0", "k0_slope", "r")
_PROGRAMS = Path(__file__).parents[2] / "deploy" / "nc" / "sinumerik"
_TRAVEL = ((-200.0, 200.0), (-200.0, 200.0), (0.0, 300.0))
_WRITE_REQUEST = b"\x01\x00\xa1\x02"
"""The beginning of a WriteRequest (i=673) in OPC UA's binary encoding."""
_OFFSETS = (b"/R[u1,100]", b"TEMP_COMP_ABS_VALUE[u1]", b"/R[u1,90]")
_TABLES = {name: CEC_TABLES.index(pair) for name, pair in PAIRS.items()}
_TARGETS_UM = np.array([8.0, 12.0, 10.0, 6.0, 8.0, 5.0, 20.0, 20.0, 20.0])


@dataclass
class Disturbed:
    """What a run found."""

    largest_um: dict[str, float]
    """Largest change of any axis within one period, after each kind of disturbance."""
    counts: Counter[str]
    disarmings: tuple[Notice, ...]
    """What a gateway said when it disarmed itself."""
    moved_um: float
    """The largest offset in force at any time: an offset of zero cannot step."""
    seconds: float


@dataclass
class NcSite:
    """One control at the end of a connection, and the gateway that uses it now."""

    wire: CutWire
    section: Mapping[str, object]
    """`[nc]` of the gateway's file."""
    make: Callable[[], NumericalControl]
    """The driver."""
    writes: Callable[[bytes], bool]
    """Whether a message writes offsets."""
    draw: random.Random
    late_s: tuple[float, float]
    pace: float = 1.0
    """A factor on every time and, inversely, on the slew."""
    notices: list[Notice] = field(default_factory=list)
    owner: int = 1
    disarmings: list[Notice] = field(default_factory=list)
    """What a gateway said when it disarmed itself."""
    link: NcLink | None = None
    _task: asyncio.Task[None] | None = None
    _nc: NumericalControl | None = None

    def start(self) -> None:
        """Start a gateway, which knows the one before it."""
        clock = RealClock()
        self._nc = self.make()
        config = validate(
            {
                "machine": {"name": "mill"},
                "nc": {**self.section, "period_s": PERIOD_S * self.pace},
                "compensation": {
                    "mode": "compensate", "slew_um_per_s": SLEW_UM_PER_S / self.pace, "bound_um": BOUND_UM,
                    "stale_after_s": 1e6, "watchdog_s": SILENCE_S * self.pace,
                },
            }
        )  # fmt: skip
        identity = Identity(self.owner, self.owner - 1 or None)
        self.owner += 1
        listeners = Listeners(notify=self.notices.append)
        self.link = NcLink(self._nc, clock, LinkSettings.of(config, identity), Earlier(first_number=41), listeners)
        self.aim()
        self._task = asyncio.create_task(self.link.run())

    def aim(self) -> None:
        """Set another prediction."""
        errors = _TARGETS_UM * np.array([self.draw.uniform(-1, 1) for _ in range(9)])
        nothing = np.full(9, np.nan)
        assert self.link is not None
        self.link.follow(Decision(1, Phase.COMPENSATION, errors, errors, nothing, nothing, None, None, ()))

    async def end(self, *, stopped: bool) -> None:
        """Kill the gateway, or tell it to stop."""
        assert self._task is not None
        assert self.link is not None
        assert self._nc is not None
        died = self._task.done()
        self._task.cancel()
        [error] = await asyncio.gather(self._task, return_exceptions=True)
        assert not died, error
        if stopped:
            await self.link.stop()
        else:
            self.wire.abort()
        await self._nc.close()

    async def disturb(self, kind: str) -> None:
        draw, wire, pace = self.draw, self.wire, self.pace
        match kind:
            case "kill" | "stop":
                await self.end(stopped=kind == "stop")
                await asyncio.sleep(pace * draw.uniform(0.0, 2 * SILENCE_S))
                self.start()
            case "cut":
                for _ in range(draw.randint(1, 4)):
                    wire.abort()
                    await asyncio.sleep(pace * draw.uniform(0.0, SILENCE_S))
            case "silence":
                wire.silent = True
                await asyncio.sleep(pace * draw.uniform(0.5, 2 * SILENCE_S))
                wire.silent = False
            case "hang":
                await asyncio.sleep(pace * draw.uniform(0.0, PERIOD_S))
                time.sleep(pace * draw.uniform(0.5, 2 * SILENCE_S))  # noqa: ASYNC251 - this process stands still
            case "late":
                wire.delay = _once(self.writes, pace * draw.uniform(*self.late_s))
                for _ in range(9):
                    await asyncio.sleep(pace * 5.0)
                    self.aim()
                wire.delay = None
            case "malformed":
                spoil = changes(draw.randrange(2**31))
                wire.spoil = lambda data: next(spoil)(data) if draw.random() < 0.3 else data
                await asyncio.sleep(pace * draw.uniform(2.0, 10.0))
                wire.spoil = None
            case _:
                raise ValueError(kind)

    async def keep_armed(self) -> None:
        """Start a gateway again that has disarmed itself, as an operator would."""
        assert self.link is not None
        if not self.link.armed:
            self.disarmings.append(next(n for n in reversed(self.notices) if n.code in DISARMING))
            await self.end(stopped=False)
            self.start()

    async def disturb_all(self, count: int, kinds: Sequence[str], clock: RealClock) -> list[tuple[float, str]]:
        """Cause this many disturbances of these kinds in turn, with other predictions between; returns when each began,
        and its kind."""
        events: list[tuple[float, str]] = []
        for number in range(count):
            kind = kinds[number % len(kinds)]
            events.append((clock.monotonic(), kind))
            await self.disturb(kind)
            for _ in range(self.draw.randint(2, 5)):
                self.aim()
                await asyncio.sleep(self.pace * self.draw.uniform(2.0, 6.0))
                await self.keep_armed()
        return events


def _writes_offsets(data: bytes) -> bool:
    return _WRITE_REQUEST in data and any(name in data for name in _OFFSETS)


def _once(chosen: Callable[[bytes], bool], late_s: float) -> Callable[[bytes], float]:
    """Hold one message."""
    held = False

    def delay(data: bytes) -> float:
        nonlocal held
        if held or not chosen(data):
            return 0.0
        held = True
        return late_s

    return delay


async def disturbed(
    route: str, count: int, seed: int, *, kinds: Sequence[str] = KINDS, late_s: tuple[float, float] = (0.1, 40.0)
) -> Disturbed:
    """Run `count` disturbances of these kinds in turn on a route. late_s: how long a write is held."""
    draw, clock = random.Random(seed), RealClock()
    plain = driver_settings(route)
    day = LoadCase([DayPart(0.0, 1e12, Activity.PAUSE, MeanLoads())])
    cycle = CycleSettings(noise_um=0.0)
    async with AsyncExitStack() as stack:
        control = EmulatedControl(
            Rigid(), clock, day, cycle=cycle, programs=programs_of(plain), r_count=R_COUNT_WITH_ERRORS
        )
        record = ShiftRecord(control.nck)
        url = await control.start()
        stack.push_async_callback(asyncio.get_running_loop().shutdown_default_executor)
        stack.push_async_callback(control.stop)
        wire, joined = await stack.enter_async_context(wire_to(url))
        settings, began_s = plain.model_copy(update={"url": joined}), clock.monotonic()
        section = {"kind": "sinumerik", "url": joined, "security": "none"}
        site = NcSite(wire, section, lambda: make_sinumerik(settings, clock), _writes_offsets, draw, late_s)
        site.start()
        await asyncio.sleep(20.0)
        events = await site.disturb_all(count, kinds, clock)
        await site.end(stopped=True)
        end_s = clock.monotonic()
        control.nck.advance(end_s)
    largest, moved = largest_changes(record, events, (began_s, end_s))
    return Disturbed(largest, Counter(kind for _, kind in events), tuple(site.disarmings), moved, end_s - began_s)


def driver_settings(route: str) -> SinumerikSettings:
    """The driver's settings on a route."""
    return SinumerikSettings(
        security="none",
        url="opc.tcp://nc",
        timeout_s=1.0,
        session_s=SILENCE_S / 2,
        origin_tool_mm=0.0,
        compensation=_compensation(route),
    )


def _compensation(route: str) -> OffsetRoute:
    match route:
        case "errors":
            return OffsetRoute(route="errors", travel_mm=_TRAVEL)
        case "k0":
            return OffsetRoute(route="k0")
        case "k0_slope":
            return OffsetRoute(route="k0_slope", travel_mm=_TRAVEL, tables=_TABLES)
        case "r":
            return OffsetRoute(route="r")
        case _:
            raise ValueError(f"route = {route!r}: expected one of {ROUTES}")


def programs_of(settings: SinumerikSettings) -> list[str]:
    """What the control runs for a route."""
    if settings.compensation.route == "errors":
        return [errors_program(settings, ErrorTerms(SLEW_UM_PER_S, 120.0, BOUND_UM))]
    names = ("TALC_START", "TALC_SLOPES")[: 2 if settings.compensation.route == "k0_slope" else 1]
    return [(_PROGRAMS / f"{name}.SPF").read_text("utf-8") for name in names]


class ShiftRecord:
    """The control's shift in every corner of the travel, whenever it changes."""

    def __init__(self, nck: Nck) -> None:
        self._nck, self._last = nck, _settings_of(nck)
        self.times = [0.0]
        self.shifts_um = [self.corners()]
        nck.watched = self.note

    def corners(self) -> FloatArray:
        """(24,) µm"""
        return np.array([self._nck.shift_um(corner) for corner in itertools.product(*_TRAVEL)]).ravel()

    def note(self, now_s: float) -> None:
        """Look whether it has changed."""
        state = _settings_of(self._nck)
        if state != self._last:
            self._last = state
            self.times.append(now_s)
            self.shifts_um.append(self.corners())


def _settings_of(nck: Nck) -> tuple[float, ...]:
    """Everything that the shift depends on while the axes stand still."""
    return (
        float(nck.referenced),
        *nck.k0_mm,
        *nck.slope,
        *nck.reference_mm,
        *nck.table_weight,
        *nck.r[R_OFFSETS : R_OFFSETS + 3],
    )


def largest_changes(
    record: ShiftRecord, events: Sequence[tuple[float, str]], span_s: tuple[float, float]
) -> tuple[dict[str, float], float]:
    """Largest change of any axis within one period after each kind of event, and the largest shift, µm.

    events: when each began, and its kind; span_s: the first and the last moment that count
    """
    times = np.arange(*span_s, IPO_S)
    at = np.searchsorted(record.times, times + IPO_S / 2, side="right") - 1
    values: FloatArray = np.array(record.shifts_um)[at]
    window = round(PERIOD_S / IPO_S)  # what is written at the beginning of the next one does not count
    change = (maximum_filter1d(values, window, axis=0) - minimum_filter1d(values, window, axis=0)).max(axis=1)
    bounds = np.searchsorted(times, [when for when, _ in events])
    largest: dict[str, float] = {}
    for (_, kind), first, last in zip(events, bounds, [*bounds[1:], len(times)], strict=True):
        largest[kind] = max(largest.get(kind, 0.0), float(change[first:last].max()))
    return largest, float(np.abs(values).max())


def run(route: str, count: int, seed: int) -> Disturbed:
    """In simulated time."""
    with simulated_time():
        return asyncio.run(disturbed(route, count, seed))


@click.command()
@click.option("--count", default=200, show_default=True, help="Disturbances.")
@click.option("--seed", default=1, show_default=True)
@click.option("--route", type=click.Choice(ROUTES), default="errors", show_default=True)
def main(count: int, seed: int, route: str) -> None:
    """Disturb the gateway's link COUNT times. Exit code 1: something moved farther in a period than the slew allows."""
    logging.disable(logging.CRITICAL)
    found = run(route, count, seed)
    for kind, largest in found.largest_um.items():
        click.echo(f"{kind:<10}{found.counts[kind]:>5} times, largest change within one period {largest:.3f} µm")
    click.echo(f"{found.seconds:.0f} s, offsets up to {found.moved_um:.1f} µm, disarmed {len(found.disarmings)} times")
    for notice in found.disarmings:
        click.echo(f"  disarmed: {notice.code} {dict(notice.values)}")
    sys.exit(0 if max(found.largest_um.values()) <= SLEW_UM_PER_S * PERIOD_S * 1.001 + 1e-6 else 1)


if __name__ == "__main__":
    main()
