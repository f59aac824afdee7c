"""One life of a gateway whose moment of death is a number.

The gateway is the whole service with its store. Its control is the emulated one; what the gateway writes to it outlives
the gateway. Time is simulated.
"""

import asyncio
import random
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from unittest.mock import patch

import numpy as np

from drivers.nc import NcSnapshot, RequestStatus
from gateway.config.extended import validate
from gateway.config.model import GatewayConfig
from gateway.control.restart.earlier import earlier_run
from gateway.control.restart.snapshots import SnapshotKeeper
from gateway.model.events import DecisionMade, Events, GatewayEvent
from gateway.nc.settings import Identity
from gateway.service.service import Service
from gateway.storage.store import Store
from simulators.nc import Nck
from talc.control import Controller
from talc.frame import Decision, Frame
from tests.benches import idle_loop
from tests.benches.death import PROBING, Death
from tests.benches.emulated_bench import expected_deviation_um
from tests.benches.in_process_nc import WithoutDryRun
from tests.benches.outlives import KeptNck, SharedMemory
from tests.benches.spoilt_stores import reading
from tests.benches.wire_clock import WireClock

LIMIT_S = 600.0  # real time for one life; it takes a tenth of a second
PERIOD_S = 10.0
_STEP_S, _STEPS_A_LIFE, _STEPS_A_SNAPSHOT = 300.0, 4, 6
_MOMENTS_OF_A_REQUEST = 10
"""Out of about 45 moments of a cycle, so that many gateways die just after the number has reached the control."""


def _config_in(folder: Path) -> GatewayConfig:
    """A gateway without devices; its inputs are states of the control."""
    return validate(
        {
            "machine": {"name": "mill"},
            "telemetry": {"enabled": False},
            "storage": {
                "path": str(folder / "g.sqlite"),
                "compensate_unstored": True,
                "unstored_after_s": 1e-6,
                "warn_free_mb": 0.0,
            },
            "nc": {
                "kind": "sinumerik",
                "url": "opc.tcp://127.0.0.1:4840",
                "security": "none",
                "period_s": PERIOD_S,
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


class SwingingPlant:
    """A machine whose errors follow the time, so that every gateway has something to correct."""

    def tool_deviation_um(
        self, time_s: float, x_mm: float, y_mm: float, z_mm: float, a_deg: float, c_deg: float
    ) -> tuple[float, float, float]:
        errors = {"EZ0A": 20.0 * np.sin(time_s / 1500.0), "EX0C": 12.0 * np.sin(time_s / 2100.0)}
        x, y, z = expected_deviation_um(errors, a_deg, c_deg)
        return float(x), float(y), float(z)


class KeptControl(WithoutDryRun):
    """The control as the gateway sees it; a cycle is the phase `probing`."""

    def __init__(self, nck: Nck, clock: WireClock, requests: list[int], death: Death) -> None:
        super().__init__(nck, clock)
        self._requests, self._death = requests, death

    async def request_probing(self, number: int, dry_run_mm: float = 0.0) -> None:
        self._death.begin(PROBING)
        self._requests.append(number)
        await super().request_probing(number, dry_run_mm)
        for _ in range(_MOMENTS_OF_A_REQUEST):
            self._death.asks_control()

    async def probing_status(self, number: int) -> RequestStatus:
        self._death.asks_control()
        return await super().probing_status(number)

    async def snapshot(self) -> NcSnapshot:
        self._death.asks_control()
        return await super().snapshot()

    async def heartbeat(self, owner: int) -> bool:
        self._death.asks_control()
        return await super().heartbeat(owner)


class GatewayLife:
    """One run of a gateway on what the earlier ones left, in its own process."""

    def __init__(self, folder: Path, memory: SharedMemory, number: int, death: Death, draw: random.Random) -> None:
        self._config, self._name = _config_in(folder), f"life {number}"
        self._memory, self._death, self._draw = memory, death, draw
        self._left, self._clock = memory.kept(), WireClock()
        self._first = len(self._left.decided)
        """The first step that it decides itself; what an earlier gateway decided may have died with it."""
        self._clock.spend(self._left.now_s)
        self._clock.started_as = "the computer was not switched off"
        KeptNck.changed = self._keep

    def _keep(self) -> None:
        self._left.now_s = self._clock.monotonic()
        self._memory.keep(self._left)

    def live(self) -> None:
        """Start, do some steps, stop."""
        idle_loop.run(self._live())

    async def _live(self) -> None:
        death, step = self._death, Controller.step

        def learning(controller: Controller, frame: Frame) -> Decision:
            if frame.measurement is None:
                return step(controller, frame)
            death.end(PROBING)
            if self._draw.random() < 0.5:
                store.flush()  # as if learning took long: the frame is on the disk, its decision is not
            with death.within("learning"):
                return step(controller, frame)

        with ExitStack() as stack:
            with death.within("start"):
                store = Store(
                    self._config.storage.path, self._name, self._clock, commit_s=0.01, retry_s=0.01,
                    hangs_after_s=LIMIT_S, silent_s=LIMIT_S, origin="here",
                )  # fmt: skip
                stack.enter_context(store)
            with death.within("rebuild"):
                past = earlier_run(store, self._config)
            assert not store.health.mended, store.health.mended
            stack.enter_context(patch.object(Controller, "step", learning))
            with death.within("start"):
                store.begin(self._config.canonical(), self._config.fingerprint(), "")
                keeper = SnapshotKeeper(past, store, self._config, every_steps=_STEPS_A_SNAPSHOT)
                control = KeptControl(self._left.nck, self._clock, self._left.requests, death)
                with patch("gateway.service.service.control_of", lambda *_: control):
                    sinks = self._note, store.record, partial(self._flush, store), keeper.take
                    service = Service(
                        self._config, self._clock, Events(*sinks).publish, past,
                        health=lambda: store.health, identity=Identity.of(self._name, store.predecessor),
                        on_disk=partial(self._on_disk, store),
                    )  # fmt: skip
            await self._run(service, store)
            death.begin("stop")
        death.end("stop")
        self._all_stored()

    def _all_stored(self) -> None:
        self._left.stored = sorted({*self._left.stored, *self._left.decided[self._first :]})
        self._keep()

    async def _run(self, service: Service, store: Store) -> None:
        stop = asyncio.Event()
        running = asyncio.create_task(service.run(stop))
        for _ in range(_STEPS_A_LIFE):
            for i in range(3):
                store.record(reading(10 * len(self._left.decided) + i))
            await self._clock.run_until(self._clock.monotonic() + _STEP_S)
            assert not running.done(), running
        self._death.end(PROBING)
        with self._death.within("stop"):
            stop.set()
            while not running.done():
                await self._clock.run_until(self._clock.monotonic() + PERIOD_S)
            await running

    async def _on_disk(self, store: Store) -> None:
        with self._clock.hold():
            await store.on_disk(LIMIT_S)

    def _flush(self, store: Store, event: GatewayEvent) -> None:
        """Wait for half of the decisions at once, which finds a commit that comes later than reported."""
        if isinstance(event, DecisionMade) and self._draw.random() < 0.5:
            store.flush()
            self._all_stored()

    def _note(self, event: GatewayEvent) -> None:
        if isinstance(event, DecisionMade):
            self._left.decided.append(event.decision.k)
            self._keep()
