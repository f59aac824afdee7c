"""The emulated control behind its real protocol, in time that the test advances, with the driver connected."""

import asyncio
import math
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from drivers.nc import NumericalControl, RequestStatus
from drivers.sinumerik.control import Sinumerik
from drivers.sinumerik.settings import SinumerikSettings, StateNode
from simulators.nc import Activity, CycleSettings, DayPart, EmulatedControl, FollowingTerms, LoadCase, MeanLoads, User
from simulators.nc.variables import COOLANT, PROBE_IN_SPINDLE
from tests.benches.manual_clock import ManualClock

POSES = ((0, 0), (0, 90), (0, 180), (0, 270), (90, 0), (-90, 0))
RADIUS_MM, HEIGHT_MM = 120.0, 80.0
CUTTING_S = 1000.0
"""The program cuts for this long, with a safe point each 40 s, and stands still afterwards."""


class Rigid:
    """A machine without errors."""

    def tool_deviation_um(
        self, time_s: float, x_mm: float, y_mm: float, z_mm: float, a_deg: float, c_deg: float
    ) -> tuple[float, float, float]:
        return 0.0, 0.0, 0.0


@dataclass
class DayPlant:
    """A machine with constant errors: position errors in µm, orientation errors in µm/m."""

    errors: dict[str, float] = field(default_factory=dict)
    asked_at_s: list[float] = field(default_factory=list)

    def tool_deviation_um(
        self, time_s: float, x_mm: float, y_mm: float, z_mm: float, a_deg: float, c_deg: float
    ) -> tuple[float, float, float]:
        self.asked_at_s.append(time_s)
        x, y, z = expected_deviation_um(self.errors, a_deg, c_deg)
        return x, y, z


ERRORS = ("EY0A", "EZ0A", "EX0C", "EY0C", "EZ0T", "ER0T", "EA0C", "EB0C", "EC0C")


def expected_deviation_um(errors: dict[str, float], a_deg: float, c_deg: float) -> NDArray[np.float64]:
    """Small-angle deviation of the sphere's centre: A's position, then C's position and orientation, turned by A."""
    e = {name: errors.get(name, 0.0) for name in ERRORS}
    a, c = math.radians(a_deg), math.radians(c_deg)
    turn_a = np.array([[1, 0, 0], [0, math.cos(a), -math.sin(a)], [0, math.sin(a), math.cos(a)]])
    turn_c = np.array([[math.cos(c), -math.sin(c), 0], [math.sin(c), math.cos(c), 0], [0, 0, 1]])
    sphere_m = turn_c @ np.array([RADIUS_MM, 0, HEIGHT_MM]) * 1e-3
    on_table = np.array([e["EX0C"], e["EY0C"], 0]) + np.cross([e["EA0C"], e["EB0C"], e["EC0C"]], sphere_m)
    on_table = on_table + e["ER0T"] * turn_c[:, 0] + np.array([0, 0, e["EZ0T"]])
    deviation: NDArray[np.float64] = np.array([0, e["EY0A"], e["EZ0A"]]) + turn_a @ on_table
    return deviation


@dataclass
class OpcUaBench:
    """One control and the driver under test, with what the tests do to the control."""

    nc: NumericalControl
    clock: ManualClock
    plant: DayPlant
    control: EmulatedControl
    url: str

    async def cycle(self, number: int) -> RequestStatus:
        """Ask and let a whole cycle pass."""
        await self.nc.request_probing(number)
        self.clock.move_to(self.clock.now + 200.0)
        return await self.nc.probing_status(number)


def day() -> LoadCase:
    loads = MeanLoads(x=1200.0, y=600.0, z=300.0, a=2.0, c=30.0, spindle=6000.0, coolant=1.0)
    blocks = [DayPart(0.0, CUTTING_S, Activity.ROUGHING, loads), DayPart(CUTTING_S, 1e6, Activity.PAUSE, MeanLoads())]
    return LoadCase(blocks, operation_s=40.0)


def wired(plain: SinumerikSettings) -> SinumerikSettings:
    """Settings with the bits that the emulated control's machine builder has wired."""
    states = {**plain.state_sources, "coolant": StateNode(path=COOLANT)}
    nodes = plain.nodes.model_copy(update={"probe_in_spindle": PROBE_IN_SPINDLE})
    return plain.model_copy(update={"nodes": nodes, "states": states})


@asynccontextmanager
async def sinumerik_bench(
    users: dict[str, User] | None = None, noise_um: float = 0.0, errors: FollowingTerms | None = None
) -> AsyncIterator[OpcUaBench]:
    clock, plant = ManualClock(), DayPlant()
    control = EmulatedControl(plant, clock, day(), cycle=CycleSettings(noise_um=noise_um), users=users, errors=errors)
    url = await control.start()
    nc = Sinumerik(wired(SinumerikSettings(security="none", url=url)), clock)
    try:
        if users is None:
            await nc.connect()
        yield OpcUaBench(nc, clock, plant, control, url)
    finally:
        await nc.close()
        await control.stop()
        await asyncio.get_running_loop().shutdown_default_executor()  # the server library loads its nodes in it
