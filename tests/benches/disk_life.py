"""A short life of a gateway on a disk that refuses calls.

The gateway is the whole service with its store, the control is the emulated one in this process, and time is simulated;
only the store's thread runs in real time. A layer under the process (`failing_disk.cc`) counts the calls and refuses
them.
"""

import asyncio
import ctypes
import math
import re
import sqlite3
from contextlib import ExitStack, closing, suppress
from pathlib import Path
from unittest.mock import patch

from gateway.config.extended import validate
from gateway.config.model import GatewayConfig
from gateway.control.replay.stored import replay
from gateway.control.restart.earlier import EarlierRun, earlier_run
from gateway.control.restart.snapshots import SnapshotKeeper
from gateway.model.events import DecisionMade, Events, GatewayEvent
from gateway.nc.settings import Identity
from gateway.service.service import Service
from gateway.storage.damage import damage_found
from gateway.storage.faults import StoreError
from gateway.storage.history import History
from gateway.storage.readings import Retention
from gateway.storage.store import Store
from simulators.nc import Activity, CycleSettings, DayPart, LoadCase, MeanLoads, Nck
from talc.names import THERMAL_ERRORS
from tests.benches import idle_loop
from tests.benches.disk_faults import HANGS_ONCE, DiskFault, LifeVerdict
from tests.benches.emulated_bench import DayPlant
from tests.benches.in_process_nc import WithoutDryRun
from tests.benches.spoilt_stores import reading
from tests.benches.waits import until
from tests.benches.wire_bench import assert_never_stepped
from tests.benches.wire_clock import WireClock

_STEP_S, _PERIOD_S = 300.0, 10.0
_SWING_UM, _SWING_S = 20.0, 1500.0
"""The swing of the plant's error, so that there is always something to correct."""
_STEPS_A_RUN, _HEALED_AFTER_STEPS, _RUNS = 5, 2, 3
LIMIT_S = 900
"""Real seconds of one life; it takes less than one."""
_STARTS = 3
"""The starts of one run: the fault ends with the first that is refused."""


def config_in(folder: Path, *, continues: bool) -> GatewayConfig:
    """A gateway without devices; its inputs are states of the control.

    continues: whether it compensates while nothing can be stored
    """
    return validate(
        {
            "machine": {"name": "mill"},
            "telemetry": {"enabled": False},
            "storage": {
                "path": str(folder / "g.sqlite"),
                "compensate_unstored": continues,
                "unstored_after_s": 1e-6,
                "warn_free_mb": 0.0,
            },
            "nc": {
                "kind": "sinumerik",
                "url": "opc.tcp://127.0.0.1:4840",
                "security": "none",
                "period_s": _PERIOD_S,
            },
            "grid": {"step_s": _STEP_S},
            "probing": {
                "armed": True,
                "lead_s": 200.0,
                "poll_s": 10.0,
                "reference_cycles": 1,
                "prefer_idle_s": 0.0,
                "dry_run": "not offered",
            },
            "compensation": {"mode": "compensate", "watchdog_s": 60.0},
            "talc": {"learner": {"shortest_interval_steps": 1, "longest_interval_steps": 2}},
        }
    )


class Life:
    """One gateway and its control.

    Parameters
    ----------
    folder: of the database, on the disk that fails
    fault, at: at which call it begins; None: the disk works
    """

    def __init__(self, folder: Path, fault: DiskFault | None, at: int) -> None:
        self.verdict = LifeVerdict()
        self._healed = False
        self._config = config_in(folder, continues=at % 2 == 1)
        self._path = self._config.storage.path
        self._clock, self._plant = WireClock(), DayPlant()
        self._corrected_um = 0.0
        """EZ0A by the last decision."""
        rest = LoadCase([DayPart(0.0, 1e12, Activity.PAUSE, MeanLoads())])
        self._nck = Nck(self._plant, rest, cycle=CycleSettings(noise_um=0.0))
        self._disk = ctypes.CDLL(None)
        self._disk.disk_call_names.restype = ctypes.c_char_p
        self._made: list[int] = []
        """Grid indices of the steps that were decided."""
        self._lost: set[int] = set()
        """Those of them that belong to a run which reported that it could not store everything."""
        self._hangs = fault is not None and fault.error == HANGS_ONCE
        self._hangs_after_s = LIMIT_S if fault is None or not self._hangs else fault.hang_ms / 3e3
        if fault is None:
            self._disk.fail_from(0, 0, 0, 0)
        else:
            self._disk.fail_from(at, fault.error, fault.lasting, fault.hang_ms)

    def live(self) -> LifeVerdict:
        """All runs; never raises but for mistakes of the bench."""
        return idle_loop.run(self._live())

    async def _live(self) -> LifeVerdict:
        for number in range(_RUNS):
            if number == _RUNS - 1:
                self._damage()
            for _ in range(_STARTS):
                if await self._run(f"run {number}"):
                    break
                self.verdict.not_started += 1
                self._heal()
            else:
                self.verdict.wrong.append(f"run {number} does not start although the disk works")
        self._heal()
        try:
            self._judge()
        except (StoreError, sqlite3.Error) as error:
            self.verdict.wrong.append(f"what is left cannot be read: {error!r}")
        return self.verdict

    def _heal(self) -> None:
        """The disk works from now on."""
        if not self._healed:
            self._healed = True
            self.verdict.calls = self._disk.disk_call_names().decode()
            self.verdict.refused = self._disk.disk_faults()
            self._disk.fail_from(0, 0, 0, 0)

    def _damage(self) -> None:
        """Make the file state a different version from the one it was written with; nothing in it is lost."""
        self._disk.pause_disk_faults(1)
        with closing(sqlite3.connect(self._path)) as connection:
            connection.execute("PRAGMA user_version = 3")
        self._disk.pause_disk_faults(0)

    async def _run(self, boot: str) -> bool:
        """One run of a gateway; returns whether it started."""
        first, started = len(self._made), False
        name = f"{boot} {first} {self.verdict.not_started}"
        try:
            with ExitStack() as stack:
                store = stack.enter_context(
                    Store(
                        self._path, name, self._clock, commit_s=0.01,
                        retention=Retention(samples_days=0.01, minutes_days=0.01), retry_s=0.01,
                        hangs_after_s=self._hangs_after_s, silent_s=LIMIT_S, origin="here",
                    )
                )  # fmt: skip
                past = earlier_run(store, self._config)
                store.begin(self._config.canonical(), self._config.fingerprint(), "")
                started = True
                await self._serve(store, name, past)
        except (StoreError, OSError) as error:
            if not started:
                return False
            said = re.search(r"(\d+) rows were not stored", str(error))
            if said is None:
                self.verdict.wrong.append(f"{boot}: the end says not what is lost: {error!r}")
            else:
                self.verdict.told_lost += int(said[1])
            self._lost.update(self._made[first:])
        except Exception as error:  # noqa: BLE001 - whatever it is, it is the result
            self.verdict.wrong.append(f"{boot}: {'runs' if started else 'starts'}: {error!r}")
            return started
        if started and self._in_force() != (0.0, 0.0, 0.0):
            self.verdict.wrong.append(f"{boot}: stopped with {self._in_force()} in force")
        return True

    async def _serve(self, store: Store, name: str, past: EarlierRun) -> None:
        keeper = SnapshotKeeper(past, store, self._config, every_steps=4)

        async def on_disk() -> None:
            with self._clock.hold():
                await store.on_disk(LIMIT_S)

        with patch("gateway.service.service.control_of", lambda *_: WithoutDryRun(self._nck, self._clock)):
            service = Service(
                self._config, self._clock, Events(store.record, self._note, keeper.take).publish, past,
                health=lambda: store.health, identity=Identity.of(name, store.predecessor),
                on_disk=on_disk,
            )  # fmt: skip
        stop = asyncio.Event()
        running = asyncio.create_task(service.run(stop))
        failing_steps = 0
        try:
            for n in range(_STEPS_A_RUN):
                for i in range(3):
                    store.record(reading(10 * len(self._made) + i))
                await self._clock.run_until(self._clock.monotonic() + _STEP_S)
                if running.done():
                    break
                await self._settle(store)
                self._plant.errors["EZ0A"] = _SWING_UM * math.sin(self._clock.monotonic() / _SWING_S)
                if store.health.problem:
                    failing_steps += 1
                    self.verdict.unstored += 1
                    if failing_steps == _HEALED_AFTER_STEPS:
                        self._check_state(n)
                        self._heal()
                        await self._recovered(store)
        finally:
            stop.set()
            ending = asyncio.ensure_future(running)
            while not ending.done():
                await self._clock.run_until(self._clock.monotonic() + _PERIOD_S)
            await ending

    async def _settle(self, store: Store) -> None:
        """Wait for the store's thread, so that each life makes the same calls; one that hangs, until the store says so.

        Otherwise simulated hours would pass in the seconds of the hang.
        """
        if self._hangs:
            await until(lambda: store.health.problem or not store.health.waiting)
            return
        with suppress(StoreError):  # the health says it
            store.flush()

    def _check_state(self, step: int) -> None:
        """Nothing could be stored for two steps."""
        z, wanted = self._in_force()[2], self._corrected_um if self._config.storage.compensate_unstored else 0.0
        if abs(z - wanted) >= 1.0:
            self.verdict.wrong.append(f"step {step}: {z:g} µm in force while nothing can be stored, not {wanted:g}")
        self.verdict.states_seen += abs(self._corrected_um) > 2.0

    async def _recovered(self, store: Store) -> None:
        """Wait in real time until it stores again, by itself."""
        for _ in range(LIMIT_S * 100):
            health = store.health
            if not health.problem and not health.waiting:
                return
            await asyncio.sleep(0.01)
        self.verdict.wrong.append(f"the disk works, and the store says {store.health}")

    def _note(self, event: GatewayEvent) -> None:
        if isinstance(event, DecisionMade):
            self._made.append(event.decision.k)
            self._corrected_um = float(event.decision.corrected[THERMAL_ERRORS.index("EZ0A")])

    def _in_force(self) -> tuple[float, float, float]:
        self._nck.advance(self._clock.monotonic())
        x, y, z = (round(-1e3 * value, 6) + 0.0 for value in self._nck.k0_mm)
        return x, y, z

    def _judge(self) -> None:
        """Judge the control's record and the store that is left."""
        wrong = self.verdict.wrong
        try:
            assert_never_stepped(self._nck.log, (50.0, 50.0, 50.0), 1.0, _PERIOD_S)
        except AssertionError as error:
            wrong.append(f"a step: {error}")
        wrong += damage_found(self._path)
        with History(self._path) as history:
            steps = [step.frame.k for step in history.steps()]
            result = replay(history)
        if not result.identical:
            wrong.append(f"replay: {result.first}")
        if len(set(self._made)) != len(self._made):
            wrong.append(f"steps were decided twice: {self._made}")
        if missing := sorted(set(self._made) - set(steps) - self._lost):
            wrong.append(f"steps {missing} of {self._made} are not stored, and nothing told it")
