"""One life: acquisition, control loop, NC and store on the driven clock, and what of it is not as it must be."""

import asyncio
import ctypes
import gc
import math
import random
import shutil
import sqlite3
import threading
import time
from collections.abc import Sequence
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from drivers.base import Quality
from gateway.control.replay.stored import replay
from gateway.control.restart.earlier import EarlierRun, earlier_run
from gateway.control.restart.snapshots import SnapshotKeeper
from gateway.model.events import (
    DecisionMade,
    EventReported,
    Events,
    FrameMade,
    GatewayEvent,
    MeasurementEnded,
    ReadingsTaken,
)
from gateway.nc.settings import Identity
from gateway.runtime.ages import Ages
from gateway.service.service import Service
from gateway.storage.damage import damage_found
from gateway.storage.faults import StoreError
from gateway.storage.history import History
from gateway.storage.readings import Retention
from gateway.storage.store import Store
from simulators.nc import Activity, CycleSettings, DayPart, LoadCase, MeanLoads, Nck
from talc.frame import Event, EventKind
from tests.benches.drawn_lives.agent_host import KEY, AgentHost, Disturbances
from tests.benches.drawn_lives.configuration import BOUND_UM, SLEW_UM_PER_S, STEP_S, configuration
from tests.benches.drawn_lives.plan import QUIET_S, Plan, Trouble
from tests.benches.killed_life import SwingingPlant
from tests.benches.processes import open_links
from tests.benches.strangers.driven_loop import DrivenLoop, LoopClock, run_driven
from tests.benches.strangers.modbus_host import ForeignModbus
from tests.benches.strangers.modbus_nature import age_s, told
from tests.benches.strangers.modbus_trial import memory_of
from tests.benches.wire_bench import assert_never_stepped

_PER_S = 4.0
"""Resolution of the time that the registers tell."""
_LOOP_TOLERANCE_S = 1.0
_RESTART_S = 10.0
"""Between two starts, as systemd does it."""
_AT_ZERO_S = 300.0
"""A cycle that runs ends first, and then the ramp."""
_ENDS_WITHIN_S = 1800.0
"""A cycle that runs ends first, and then the ramp."""
_LIMIT_S = 120.0
"""Real seconds that the store's thread may take for anything."""
_SETTLED_S = 600.0
"""So long before its end a life must be as before its troubles."""


def _held() -> tuple[int, int]:
    gc.collect()
    return len(open_links()), threading.active_count()


class LifeClock(LoopClock):
    """The computer's clocks: the wall clock may be set, and be unsynchronised; the computer may be switched off."""

    def __init__(self, loop: DrivenLoop) -> None:
        super().__init__(loop)
        self.ahead_s = 0.0
        self.is_synchronised = True
        self.starts = 0

    def utc(self) -> datetime:
        return super().utc() + timedelta(seconds=self.ahead_s)

    def synchronised(self) -> bool:
        return self.is_synchronised

    def origin(self) -> str:
        return f"start {self.starts}"


@dataclass
class Lived:
    """What became of a life."""

    plan: Plan
    wrong: list[str] = field(default_factory=list)
    runs: int = 0
    steps: int = 0
    measured: int = 0
    good: int = 0
    """Readings."""
    largest_um: float = 0.0
    unstored: int = 0
    """Starts and steps on a disk that failed."""


class _Run:
    """One run of the gateway."""

    def __init__(self, store: Store, past: EarlierRun, service: Service, stack: ExitStack) -> None:
        self.store, self.past, self.service, self.stack = store, past, service, stack
        self.stop = asyncio.Event()
        self.task = asyncio.create_task(service.run(self.stop))
        self.decided: list[tuple[int, float]] = []
        """Each step's grid index, and when it was decided."""


class Life:
    """One seed. Call `live` in a process whose disk below the folder can fail (tests/benches/failing_disk.cc)."""

    def __init__(self, plan: Plan, folder: Path, key_file: Path) -> None:
        self.lived = Lived(plan)
        self._plan, self._folder, self._key = plan, folder, key_file
        key_file.write_bytes(KEY)
        self._disk = ctypes.CDLL(None)
        self._generation = 0
        self._run: _Run | None = None
        self._breaks, self._heals_s, self._failing_s = False, 0.0, math.inf
        self._dirty = False
        self._settings = configuration(plan, self._path, key_file)
        self._decided_s: dict[int, float] = {}
        self._kept: set[int] = set()
        """The steps that must be stored."""
        self._set_s: list[float] = []
        """When the wall clock was set."""
        self._read_s: dict[str, float] = {}
        self._good_s: dict[str, float] = {}

    def live(self) -> Lived:
        """All of it; what is wrong is told in the result."""
        before = _held()
        try:
            run_driven(self._live)
        except Exception as error:  # noqa: BLE001 - whatever it is, it is the result
            self.lived.wrong.append(repr(error))
        finally:
            self._disk.fail_from(0, 0, 0)
        if (after := _held()) != before:
            self.lived.wrong.append(f"descriptors and threads: {before} became {after}")
        return self.lived

    def _wrong(self, text: str) -> None:
        if len(self.lived.wrong) < 5:
            self.lived.wrong.append(f"{self._loop.time() - self._began_s:.0f} s: {text}")

    # The world -------------------------------------------------------------------------------------------------------

    async def _live(self, loop: DrivenLoop) -> None:
        self._loop, self._clock, self._began_s = loop, LifeClock(loop), loop.time()
        loop.before_time_passes = self._settle
        plan, draw = self._plan, random.Random(self._plan.seed)
        for name, nature in plan.devices.items():
            memories = {unit: memory_of(nature, unit, _PER_S) for unit in range(1, nature.units + 1)}
            loop.hosts[name] = ForeignModbus(loop, nature, memories, draw)
        rest = LoadCase([DayPart(0.0, 1e12, Activity.PAUSE, MeanLoads())])
        self._nck = Nck(SwingingPlant(), rest, cycle=CycleSettings(noise_um=0.0), seed=plan.seed)
        self._control = loop.hosts["control"] = AgentHost(loop, self._nck, draw)
        await self._start()
        moments = sorted(
            ((at_s, number, begins) for number, one in enumerate(plan.troubles)
             for at_s, begins in ((one.at_s, True), (one.at_s + one.lasts_s, False))), key=lambda m: m[0],
        )  # fmt: skip
        for at_s, number, begins in moments:
            await self._until(self._began_s + at_s)
            await self._happens(plan.troubles[number], begins=begins)
        self._heal()
        await self._until(max(self._began_s + plan.lasts_s, loop.time() + QUIET_S))
        self._check_looks()
        await self._end("stopped")
        self._judge()

    async def _until(self, at_s: float) -> None:
        await asyncio.sleep(max(0.0, at_s - self._loop.time()))
        if self._run is not None and self._run.task.done():
            raise RuntimeError("the service has ended") from self._run.task.exception()

    async def _happens(self, one: Trouble, *, begins: bool) -> None:
        if one.disk and begins:
            self._heals_s = self._began_s + one.at_s + one.lasts_s
            self._break(one)
        elif one.disk:
            self._heal()
        if one.control is not None:
            self._control.now = one.control if begins else Disturbances()
        if one.clock_s:
            self._clock.ahead_s = one.clock_s if begins else 0.0
            self._clock.is_synchronised = not begins
            self._set_s.append(self._loop.time())
        if one.restarts and begins:
            await self._end(one.restarts)
            await asyncio.sleep(one.lasts_s)
            await self._start()

    def _break(self, one: Trouble) -> None:
        """From its n-th call on, or at that one only, the disk refuses what changes it."""
        self._breaks = True
        self._disk.fail_from(one.call, one.disk, int(one.lasts_s > 0))
        if self._run is not None and one.call == 1:  # then the store knows it at once
            self._run.store.record(EventReported(Event(EventKind.OPERATOR, "the disk fails"), None))
            self._stores()

    def _heal(self) -> None:
        self._check_unstored()
        self._breaks = False
        self._disk.fail_from(0, 0, 0)
        for _ in range(1000):
            if self._run is None or self._stores():
                return
            time.sleep(0.005)
        self._wrong("the disk works, and the store does not")

    def _stores(self) -> bool:
        """Whether all that was decided is on the disk now."""
        assert self._run is not None
        try:
            self._run.store.flush()
        except StoreError:
            self._failing_s = min(self._failing_s, self._loop.time())
            return False
        self._failing_s = math.inf
        self._kept.update(k for k, _ in self._run.decided)
        return True

    def _settle(self) -> None:
        """No time passes before what was decided is stored, if it can be."""
        if self._dirty and self._run is not None:
            self._dirty = not self._stores()

    # The gateway -----------------------------------------------------------------------------------------------------

    @property
    def _path(self) -> Path:
        return self._folder / f"{self._generation}" / "g.sqlite"

    async def _start(self) -> None:
        """Start it, again and again while the disk does not let it."""
        while not self._started():
            self.lived.unstored += 1
            if not self._breaks:
                raise RuntimeError("it does not start although the disk works")
            await asyncio.sleep(_RESTART_S)
            if self._loop.time() >= self._heals_s:
                self._heal()

    def _started(self) -> bool:
        storage = self._settings.storage.model_copy(update={"path": self._path})
        config, name = (
            self._settings.model_copy(update={"storage": storage}),
            f"run {self.lived.runs} {self._loop.time():.0f}",
        )
        stack = ExitStack()
        try:
            store = stack.enter_context(
                Store(
                    config.storage.path, name, self._clock, commit_s=0.1, retry_s=0.01, hangs_after_s=_LIMIT_S,
                    silent_s=_LIMIT_S, origin=self._clock.origin(),
                    retention=Retention(samples_days=0.02, minutes_days=0.05),
                )
            )  # fmt: skip
            past = earlier_run(store, config)
        except (StoreError, OSError):
            with suppress(StoreError):
                stack.close()
            return False
        self._remembers(past)
        store.begin(config.canonical(), config.fingerprint(), "")
        keeper = SnapshotKeeper(past, store, config, every_steps=4)

        async def on_disk() -> None:
            await store.on_disk(_LIMIT_S)

        service = Service(
            config, self._clock, Events(store.record, self._note, keeper.take).publish, past,
            health=lambda: store.health, identity=Identity.of(name, store.predecessor), on_disk=on_disk,
        )  # fmt: skip
        self._run = _Run(store, past, service, stack)
        self.lived.runs += 1
        return True

    async def _end(self, how: str) -> None:
        run, self._run = self._run, None
        assert run is not None
        self._check_steps(run)
        if how in ("stopped", "damaged"):
            run.stop.set()
        else:
            self._generation += 1
            self._copy(self._folder / f"{self._generation - 1}", self._path.parent)
            self._loop.cut()
            run.task.cancel()
        async with asyncio.timeout(_ENDS_WITHIN_S):
            [ended] = await asyncio.gather(run.task, return_exceptions=True)
        if run.stop.is_set() and ended is not None:
            self._wrong(f"the service ends with {ended!r}")
        try:
            run.stack.close()
            if run.stop.is_set():
                self._kept.update(k for k, _ in run.decided)
        except StoreError as error:
            if run.stop.is_set() and not self._breaks:
                self._wrong(f"the store ends with {error!r}")
        self._failing_s = math.inf
        self._loop.is_cut = False
        self._clock.starts += how == "power cut"
        if how == "damaged":
            self._damage()

    def _damage(self) -> None:
        """Make the file state a different version from the one it was written with; nothing in it is lost."""
        self._disk.pause_disk_faults(1)
        with closing(sqlite3.connect(self._path)) as connection:
            connection.execute("PRAGMA user_version = 3")
        self._disk.pause_disk_faults(0)

    def _copy(self, folder: Path, to: Path) -> None:
        """What a kill leaves on the disk. The dying service writes to the old folder, which nobody reads again."""
        self._disk.pause_disk_faults(1)
        to.mkdir()
        for name in ("g.sqlite", "g.sqlite-wal", "g.sqlite.learnt", "g.sqlite.learnt.1"):
            if (folder / name).exists():
                shutil.copyfile(folder / name, to / name)
        self._disk.pause_disk_faults(0)

    # What must be so -------------------------------------------------------------------------------------------------

    def _note(self, event: GatewayEvent) -> None:
        now_s = self._loop.time()
        match event:
            case ReadingsTaken(readings):
                self._judge_readings(readings, now_s)
            case FrameMade(frame):
                for name, valid in zip(self._settings.input_names, frame.valid, strict=True):
                    if valid and now_s - self._good_s.get(name, -math.inf) > STEP_S + _LOOP_TOLERANCE_S:
                        self._wrong(
                            f"{name} is valid, and was not read for {now_s - self._good_s.get(name, 0.0):.0f} s"
                        )
            case DecisionMade(decision):
                assert self._run is not None
                self._run.decided.append((decision.k, now_s))
                if decision.k in self._kept:
                    self._wrong(f"step {decision.k} is decided again")
                self._decided_s[decision.k] = now_s
                self._dirty = True
                self.lived.steps += 1
                self.lived.unstored += self._failing_s < now_s
            case MeasurementEnded(outcome):
                self.lived.measured += outcome.measurement is not None
                self._dirty = True
            case _:
                pass

    def _judge_readings(self, readings: Sequence[Any], now_s: float) -> None:
        """By what the registers told: the right one, and as old as it says."""
        device = readings[0].channel.rsplit("_", 1)[0]
        since_s = now_s - self._read_s.get(device, self._began_s)
        asked = False
        for one in readings:
            if one.quality is not Quality.GOOD:
                asked = asked or one.quality is not Quality.STALE
                continue
            asked = True
            self.lived.good += 1
            self._good_s[one.channel] = now_s
            _, unit, number = one.channel.split("_")
            word = int(one.value)
            if told(word)[:2] != (int(unit), int(number)):
                self._wrong(f"{one.channel} shows register {told(word)[:2]}")
            elif (old_s := age_s(word, now_s, _PER_S)) > since_s + 2 / _PER_S:
                self._wrong(f"{one.channel} is {old_s:.2f} s old, read {since_s:.2f} s after the last")
            elif one.monotonic_s > now_s:
                self._wrong(f"{one.channel} is read in {one.monotonic_s - now_s:.2f} s")
        if asked:
            self._read_s[device] = now_s

    def _remembers(self, past: EarlierRun) -> None:
        """What must be stored is, and nothing is younger than it is."""
        ages = Ages(self._clock, STEP_S, past.moment, past.pauses)
        kept = sorted(self._kept)
        if kept and (past.last_k is None or past.last_k < kept[-1]):
            self._wrong(f"step {kept[-1]} was stored, and the last one that a restart knows is {past.last_k}")
        for k in kept:
            if past.last_k is not None and k <= past.last_k and ages.monotonic_of(k) > self._decided_s[k] + STEP_S / 2:
                self._wrong(f"step {k} is {ages.monotonic_of(k) - self._decided_s[k]:.0f} s younger than it is")

    def _check_steps(self, run: _Run) -> None:
        """The loop keeps its period, whatever happens; if the wall clock is set back, the numbers may wait for it."""
        for (k, at_s), (after, after_s) in pairwise(run.decided):
            was_set = any(at_s - STEP_S < s <= after_s for s in self._set_s)
            if after <= k or after_s - at_s > STEP_S * (1.5 if was_set else 1.0) + _LOOP_TOLERANCE_S:
                self._wrong(f"step {after} comes {after_s - at_s:.1f} s after step {k}")

    def _check_unstored(self) -> None:
        """Where nothing can be stored and it must be, the offsets have gone where they are declared to."""
        plan, since_s = self._plan, self._loop.time() - self._failing_s
        goes = self._run is not None and not plan.continues and plan.when_stale == "zero" and since_s > _AT_ZERO_S
        was_disturbed = any(
            one.control is not None and one.at_s < self._loop.time() - self._began_s for one in plan.troubles
        )
        if goes and not was_disturbed and self._nck.cycle.started_s is None and any(self._control.in_force_um()):
            self._wrong(
                f"{self._control.in_force_um()} in force after {since_s:.0f} s in which nothing could be stored"
            )

    def _check_looks(self) -> None:
        """When nothing is in the way any more, the control is looked at in its period."""
        looks = [s for s in self._control.looks_s if s > self._loop.time() - _SETTLED_S]
        gap_s = max(np.diff([*looks, self._loop.time()]), default=math.inf)
        if gap_s > 1.5 * self._plan.period_s:
            self._wrong(f"the control is looked at after {gap_s:.1f} s")

    def _judge(self) -> None:
        """The control's record, and the store that is left."""
        try:
            assert_never_stepped(self._nck.log, (BOUND_UM,) * 3, SLEW_UM_PER_S, self._plan.period_s)
        except AssertionError as error:
            self._wrong(f"a step: {error}")
        self.lived.largest_um = max((1e3 * abs(v) for entry in self._nck.log for v in entry.values_mm), default=0.0)
        if self._plan.when_stale == "zero" and self._control.in_force_um() != (0.0, 0.0, 0.0):
            self._wrong(f"stopped with {self._control.in_force_um()} in force")
        for found in damage_found(self._path):
            self._wrong(found)
        try:
            with History(self._path) as history:
                steps = {step.frame.k for step in history.steps()}
                result = replay(history)
        except (StoreError, sqlite3.Error) as error:
            self._wrong(f"what is left cannot be read: {error!r}")
            return
        if not result.identical:
            self._wrong(f"replay: {result.first}")
        if missing := sorted(self._kept - steps):
            self._wrong(f"steps {missing[:5]} are not stored")
