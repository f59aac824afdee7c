"""Gateways that start on a control whose R-parameters are old, and whose watchdog ends while they compensate.

`python -m tests.benches.watchdog_starts --count 200`: the link on an emulated SINUMERIK, over OPC UA, which runs the
programs as they are written, in simulated time. Each start draws old R-parameters, whether PROG_EVENT has called the
programs, what happens while the gateway compensates, and ends with a kill. Counted is what the gateway writes while an
action of the programs is missing, and what is left in force after a kill although none is.
"""

import asyncio
import logging
import random
import sys
from collections import Counter
from collections.abc import Sequence
from contextlib import AsyncExitStack
from dataclasses import dataclass, field
from typing import Final

import click
import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from drivers.sinumerik.make import make_sinumerik
from gateway.runtime.clocks import RealClock
from simulators.nc import Activity, CycleSettings, DayPart, EmulatedControl, LoadCase, MeanLoads, Nck
from simulators.nc.nck import R_OFFSETS
from simulators.nc.nine_errors import R_COUNT_WITH_ERRORS, R_TOOL, R_WANTED
from simulators.nc.nine_errors import R_ECHO as R_ECHO_OF_ERRORS
from simulators.nc.synchronised import SynchronisedActions
from simulators.nc.watchdog import R_BEAT, R_ECHO, R_OWNER, R_RAMP, R_SILENCE, R_SLOPE_RAMP, R_WATCH
from talc.frame import FloatArray
from tests.benches.cut_wire import wire_to
from tests.benches.emulated_bench import Rigid
from tests.benches.nc_disturbances import (
    PERIOD_S,
    ROUTES,
    SILENCE_S,
    SLEW_UM_PER_S,
    NcSite,
    ShiftRecord,
    driver_settings,
    programs_of,
)
from tests.benches.simulated_time import simulated_time

IPO_S = 0.02
EVENTS: Final = (
    "nothing", "no start", "ends", "loses an action", "reset", "end of program", "inch program", "emergency stop",
    "homes again", "power, no start", "power",
)  # fmt: skip
_LARGEST_UM: Final = 20.0
"""No shift is larger."""
_HARMLESS: Final = {"errors": range(63, 66)}
"""Actions without which silence takes everything to zero all the same."""
_WRITES: Final = {*range(R_OFFSETS, R_OFFSETS + 3), *range(R_WANTED, R_WANTED + 9), R_TOOL}


@dataclass
class Started:
    """What the starts of one route have found."""

    counts: Counter[str] = field(default_factory=Counter)
    writes: int = 0
    without: Counter[str] = field(default_factory=Counter)
    """Writes of offsets while an action of the programs was missing, by what had happened."""
    told: Counter[str] = field(default_factory=Counter)
    """Starts of this kind in which the gateway said that the watchdog does not answer."""
    left_um: float = 0.0
    """Largest shift in force at the end of a start whose watchdog was complete when the gateway was killed."""
    largest_um: float = 0.0
    """Largest change within one period."""
    moved_um: float = 0.0


class StartsBench:
    """One control whose programs come and go."""

    def __init__(self, nck: Nck, draw: random.Random, route: str, found: Started) -> None:
        self.nck, self._draw, self._route, self.found = nck, draw, route, found
        self.record = ShiftRecord(nck)
        self.blanks: list[tuple[float, float]] = []
        """From power off, or the loss of the reference, until all axes are homed: no offset acts."""
        self.complete, self.kind = True, ""
        self._put_k0, self._put_r = nck.write_k0, nck.write_r
        nck.write_k0, nck.write_r = self._write_k0, self._write_r  # type: ignore[method-assign]

    def _write_k0(self, axis: int, value_mm: float, now_s: float) -> None:
        self._count()
        self._put_k0(axis, value_mm, now_s)

    def _write_r(self, number: int, value: float, now_s: float) -> None:
        if number in _WRITES:
            self._count()
        self._put_r(number, value, now_s)

    def _count(self) -> None:
        self.found.writes += 1
        if not self.complete:
            self.found.without[self.kind] += 1

    async def power(self, clock: RealClock, *, started: bool) -> None:
        """Off, and on again with old R-parameters."""
        off_s, draw, r = clock.monotonic(), self._draw, self.nck.r
        self.nck.advance(off_s)
        if not started:
            beat = float(draw.randrange(6))
            r[R_BEAT], r[R_WATCH] = beat, draw.choice((1.0, 1.0, 1.0, 2.0, 0.0))
            for echo in (R_ECHO, R_ECHO_OF_ERRORS):
                r[echo] = draw.choice((beat, beat + 1.0, beat + 2.0, float(draw.randrange(6))))
            r[R_OWNER] = draw.choice((0.0, r[R_OWNER]))
            r[R_SILENCE], r[R_RAMP], r[R_SLOPE_RAMP] = draw.choice((0.0, 4.0, 60.0)), draw.choice((0.0, 5e-4)), 0.0
        self.nck.power_on(off_s, started=started)
        self.complete = started
        await asyncio.sleep(draw.uniform(0.1, 3.0))
        self._home(off_s, clock.monotonic())

    def _home(self, from_s: float, now_s: float) -> None:
        self.nck.reference(now_s)
        self.record.note(now_s)
        self.blanks.append((from_s - IPO_S, now_s + 2 * IPO_S))

    async def happens(self, kind: str, clock: RealClock) -> None:
        nck, draw = self.nck, self._draw
        nck.advance(clock.monotonic())
        match kind:
            case "ends" | "loses an action":
                self._lose(None if kind == "ends" else draw)
            case "reset" | "end of program":
                for _ in range(3):
                    (nck.reset if kind == "reset" else nck.end_program)(clock.monotonic())
                    await asyncio.sleep(draw.uniform(0.0, 2.0))
            case "emergency stop" | "homes again":
                began_s = clock.monotonic()
                nck.emergency_stop(began_s)
                nck.referenced = kind == "emergency stop"
                await asyncio.sleep(draw.uniform(0.1, 3.0))
                nck.clear_alarms(clock.monotonic())
                if not nck.referenced:
                    self._home(began_s, clock.monotonic())
            case "power, no start" | "power":
                await self.power(clock, started=kind == "power")
            case "inch program":
                self._actions.inch = True

    def _lose(self, draw: random.Random | None) -> None:
        """One action is replaced, or all are removed."""
        self.complete = False
        numbers = [n for n in self._actions.numbers if n not in _HARMLESS.get(self._route, ())]
        if draw is not None:
            self._actions.load(f"ID={draw.choice(numbers)} DO $AC_PARAM[60] = 1")
            return
        for number in self._actions.numbers:
            self._actions.cancel(number)

    @property
    def _actions(self) -> SynchronisedActions:
        assert self.nck.main_run is not None
        return self.nck.main_run.actions

    def shift_um(self) -> float:
        """The largest shift of any axis at any corner of the travel."""
        return float(np.abs(self.record.corners()).max())


async def starts(route: str, count: int, seed: int, kinds: Sequence[str] = EVENTS) -> Started:
    """Start a gateway `count` times on one control; these kinds of events in turn, at drawn times."""
    draw, clock, found = random.Random(seed), RealClock(), Started()
    plain = driver_settings(route)
    day = LoadCase([DayPart(0.0, 1e12, Activity.PAUSE, MeanLoads())])
    async with AsyncExitStack() as stack:
        control = EmulatedControl(
            Rigid(), clock, day, cycle=CycleSettings(noise_um=0.0), programs=programs_of(plain), ipo_s=IPO_S,
            r_count=R_COUNT_WITH_ERRORS,
        )  # fmt: skip
        bench = StartsBench(control.nck, draw, route, found)
        url = await control.start()
        stack.push_async_callback(asyncio.get_running_loop().shutdown_default_executor)
        stack.push_async_callback(control.stop)
        wire, joined = await stack.enter_async_context(wire_to(url))
        settings, began_s = plain.model_copy(update={"url": joined}), clock.monotonic()
        section = {"kind": "sinumerik", "url": joined, "security": "none"}
        site = NcSite(wire, section, lambda: make_sinumerik(settings, clock), lambda _: False, draw, (0.0, 0.0))
        for number in range(count):
            bench.kind = kind = kinds[number % len(kinds)]
            found.counts[kind] += 1
            await bench.power(clock, started=kind != "no start")
            told = len(site.notices)
            site.start()
            for part in range(3):
                await asyncio.sleep(draw.uniform(3.0, 6.0))
                site.aim()
                found.moved_um = max(found.moved_um, bench.shift_um())
                if part == 1:
                    await bench.happens(kind, clock)
            await asyncio.sleep(draw.uniform(0.0, PERIOD_S))
            await site.end(stopped=False)
            found.told[kind] += any("its watchdog" in notice.text for notice in site.notices[told:])
            await asyncio.sleep(SILENCE_S + 2 * _LARGEST_UM / SLEW_UM_PER_S)  # `k0_slope` ramps at half of the slew
            control.nck.advance(clock.monotonic())
            if bench.complete:
                found.left_um = max(found.left_um, bench.shift_um())
        found.largest_um = _largest(bench.record, bench.blanks, (began_s, clock.monotonic()))
    return found


def _largest(record: ShiftRecord, blanks: Sequence[tuple[float, float]], span_s: tuple[float, float]) -> float:
    """Largest change of any axis within one period, where offsets act."""
    times = np.arange(*span_s, IPO_S)
    at = np.searchsorted(record.times, times + IPO_S / 2, side="right") - 1
    values: FloatArray = np.array(record.shifts_um)[at]
    acts, window = np.ones(len(times), dtype=bool), round(PERIOD_S / IPO_S)
    for begin, end in blanks:
        acts[(times >= begin) & (times <= end)] = False
    edges = np.flatnonzero(np.diff(acts.astype(int), prepend=0, append=0))
    largest = 0.0
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        part = values[first:last]
        if len(part) > window:
            change = maximum_filter1d(part, window, axis=0) - minimum_filter1d(part, window, axis=0)
            largest = max(largest, float(change.max()))
    return largest


def run(route: str, count: int, seed: int) -> Started:
    """In simulated time."""
    with simulated_time():
        return asyncio.run(starts(route, count, seed))


@click.command()
@click.option("--count", default=200, show_default=True, help="Starts, of all routes together.")
@click.option("--seed", default=1, show_default=True)
@click.option("--route", type=click.Choice(ROUTES), multiple=True, help="Only these routes.")
def main(count: int, seed: int, route: tuple[str, ...]) -> None:
    """Start the gateway COUNT times. Exit code 1: it wrote without a complete watchdog, something was left in force,
    or moved farther in a period than the slew allows."""
    logging.disable(logging.CRITICAL)
    routes, wrong = route or ROUTES, False
    for each in routes:
        found = run(each, count // len(routes), seed)
        without = sum(found.without.values())
        told, largest = sum(found.told.values()), found.largest_um
        click.echo(
            f"{each:<9}{sum(found.counts.values()):>4} starts, {found.writes} writes, without a watchdog {without} "
            f"{dict(found.without) or ''}; told {told} times; largest shift {found.moved_um:.1f} µm, "
            f"left {found.left_um:.4f} µm, largest change in a period {largest:.4f} µm"
        )
        wrong |= without > 0 or found.left_um > 1e-6 or found.largest_um > SLEW_UM_PER_S * PERIOD_S * 1.001 + 1e-6
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
