"""A gateway's NC link and an emulated control on its real wire, in stepped time; the control keeps its own record."""

import asyncio
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from pathlib import Path

import numpy as np

from drivers.sinumerik.control import Sinumerik
from drivers.sinumerik.settings import SinumerikSettings
from gateway.config.extended import validate
from gateway.config.model import GatewayConfig
from gateway.model.compensation import Offsets, Write
from gateway.nc.link import NcLink
from gateway.nc.settings import Earlier, Identity, LinkSettings, Listeners
from simulators.nc import Activity, CycleSettings, DayPart, EmulatedControl, LoadCase, MeanLoads
from simulators.nc.watchdog import Logged
from tests.benches.still_machine import StillMachine
from tests.benches.wire_clock import WireClock

PERIOD_S = 1.0
BOUND_UM = (12.0, 8.0, 16.0)
STALE_S, INPUTS_STALE_S, SILENCE_S = 40.0, 25.0, 4.0


def config(
    mode: str = "compensate",
    when_stale: str = "zero",
    path: str = "gateway.sqlite",
) -> GatewayConfig:
    return validate(
        {
            "machine": {"name": "mill"},
            "storage": {"path": path},
            "nc": {"kind": "sinumerik", "url": "opc.tcp://127.0.0.1:4840", "security": "none", "period_s": PERIOD_S},
            "grid": {"step_s": 20.0},
            "probing": {"armed": False, "lead_s": 10.0},
            "compensation": {
                "mode": mode,
                "when_stale": when_stale,
                "bound_um": BOUND_UM,
                "stale_after_s": STALE_S,
                "inputs_stale_after_s": INPUTS_STALE_S,
                "watchdog_s": SILENCE_S,
            },
        }
    )


class WireBench:
    """The control, and as many links to it as a test makes."""

    def __init__(self, clock: WireClock, control: EmulatedControl, url: str, folder: Path) -> None:
        self.clock, self.control, self.url, self.folder = clock, control, url, folder
        self.writes: list[Write] = []
        self.notices: list[str] = []

    def link(
        self, mode: str = "compensate", when_stale: str = "zero", owner: int = 7, predecessor: int | None = None
    ) -> NcLink:
        return NcLink(
            Sinumerik(SinumerikSettings(security="none", url=self.url), self.clock),
            self.clock,
            LinkSettings.of(
                config(mode, when_stale, str(self.folder / "gateway.sqlite")), Identity(owner, predecessor)
            ),
            Earlier(first_number=41),
            Listeners(written=self.writes.append, notify=lambda notice: self.notices.append(notice.text)),
        )

    @asynccontextmanager
    async def running(self, link: NcLink, *, stop: bool = False) -> AsyncIterator[NcLink]:
        """Run a link; at the end cut its connection as a kill would, or stop it as asked."""
        task = asyncio.create_task(link.run())
        try:
            yield link
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)
            if stop:
                stopping = asyncio.create_task(link.stop())
                await self.clock.run_until(self.clock.monotonic() + 200.0)
                await stopping
            else:
                await link.disconnect()

    @property
    def in_force_um(self) -> Offsets:
        """What the control adds now."""
        self.control.nck.advance(self.clock.monotonic())
        x, y, z = (-1e3 * value for value in self.control.nck.k0_mm)
        return x, y, z

    def assert_never_stepped(self, *, but_at_s: float | None = None) -> None:
        """Except at `but_at_s`, when the control itself took the offsets away at power on."""
        assert_never_stepped(self.control.nck.log, BOUND_UM, 1.0, PERIOD_S, but_at_s)


_ARRIVES_S = 0.005
"""How long what is written may be on its way to the control, more at one time than at another."""


def assert_never_stepped(
    log: Sequence[Logged],
    bound_um: Sequence[float],
    rate_um_per_s: float,
    period_s: float,
    but_at_s: float | None = None,
) -> None:
    """Check in the control's own record that no axis changes faster than the rate, by more than one period's worth at
    once, or beyond its bound. What the control's watchdog ramps is noted only when somebody looks, so only its rate
    counts."""
    value, since = np.zeros(3), np.zeros(3)
    for entry in log:
        now = np.array(entry.values_mm) * 1e3
        changed = now != value
        if entry.time_s != but_at_s:
            reach = rate_um_per_s * (entry.time_s - since + _ARRIVES_S)
            if not entry.ramped:
                reach = np.minimum(reach, rate_um_per_s * period_s)
            assert (np.abs(now - value)[changed] <= reach[changed] + 1e-6).all(), (entry, value, since)
        assert (np.abs(now) <= np.array(bound_um) + 1e-6).all(), entry
        value, since = now, np.where(changed, entry.time_s, since)


@asynccontextmanager
async def wire_bench(folder: Path, cycle_s: float = 120.0, loads: MeanLoads | None = None) -> AsyncIterator[WireBench]:
    """cycle_s: duration of a probing cycle; loads: of the program that runs, None: the axes stand still"""
    clock = WireClock()
    cycle = CycleSettings(noise_um=0.0, duration_s=cycle_s, approach_s=cycle_s / 12)
    part = DayPart(0.0, 1e9, Activity.FINISHING if loads else Activity.PAUSE, loads or MeanLoads())
    control = EmulatedControl(StillMachine(), clock, LoadCase([part]), cycle=cycle)
    url = await control.start()
    try:
        yield WireBench(clock, control, url, folder)
    finally:
        await control.stop()
        await asyncio.get_running_loop().shutdown_default_executor()  # the server library loads its nodes in it
