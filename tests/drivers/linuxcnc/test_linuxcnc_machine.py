"""The files of deploy/nc/linuxcnc in the real LinuxCNC. Needs Debian's linuxcnc-uspace.

It starts, homes and moves. Its compensation is bounded and slewed, and an emergency stop does not touch it.
"""

import asyncio
import time
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from simulators.linuxcnc.machine import LinuxCncMachine, machine

pytestmark = pytest.mark.peer


@pytest.fixture
async def nc(tmp_path: Path) -> AsyncIterator[LinuxCncMachine]:
    async with machine(tmp_path) as running:
        await running.ask("switch_on")
        await running.ask("home")
        yield running


async def reaches(nc: LinuxCncMachine, signal: str, value: float) -> float:
    """Seconds until the signal has this value."""
    began = time.monotonic()
    async with asyncio.timeout(60.0):
        while await nc.number("gets", signal) != pytest.approx(value, abs=1e-9):
            await asyncio.sleep(0.01)
    return time.monotonic() - began


async def test_compensation_beyond_the_bound_stops_at_the_bound(nc: LinuxCncMachine) -> None:
    await nc.ask("hal", "setp", "talc-errors.slew-um-per-s", "1000")  # not to wait 20 s
    await nc.ask("hal", "setp", "talc-errors.ez0a", "-5000")
    await reaches(nc, "talc-z-in-force", -0.2)
    await nc.ask("mdi", "G53 G0 Z10")
    assert await nc.number("gets", "z-drive") == pytest.approx(9.8, abs=1e-6)


async def test_homing_waits_until_the_compensation_is_taken_back_and_an_emergency_stop_leaves_it(
    nc: LinuxCncMachine,
) -> None:
    await nc.ask("hal", "setp", "talc-errors.ey0a", "2")
    await reaches(nc, "talc-y-in-force", 0.002)
    assert await nc.ask("messages") == []
    await nc.ask("home")
    async with asyncio.timeout(60.0):
        while not (said := await nc.ask("messages")):
            await asyncio.sleep(0.01)
    assert "Homing denied by motion.homing-inhibit" in said[0], "it would swallow what is in force"
    assert await nc.number("gets", "y-drive") == pytest.approx(0.002, abs=1e-9)
    await nc.ask("hal", "setp", "talc-errors.aside", "1")
    await reaches(nc, "talc-y-in-force", 0.0)
    await nc.ask("messages")
    await nc.ask("home")
    assert await nc.ask("messages") == []
    await nc.ask("hal", "setp", "talc-errors.aside", "0")
    await reaches(nc, "talc-y-in-force", 0.002)
    assert (await nc.ask("state"))["position"][1] == pytest.approx(0.0, abs=1e-9)

    await nc.ask("unhome")
    await reaches(nc, "talc-y-in-force", 0.0)  # without homing nothing is in force
    await nc.ask("home")
    await reaches(nc, "talc-y-in-force", 0.002)

    await nc.ask("estop")
    assert not (await nc.ask("state"))["on"]
    assert await nc.number("gets", "talc-y-in-force") == pytest.approx(0.002, abs=1e-9)
    assert await nc.number("gets", "y-drive") == pytest.approx(0.002, abs=1e-9)


async def test_two_machines_run_beside_each_other_turn_their_tables_and_end_by_themselves(
    nc: LinuxCncMachine, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("second")
    async with machine(folder) as other:
        await other.ask("switch_on")
        await other.ask("home")
        assert (await other.ask("state"))["homed"] == [1] * 5
        await other.ask("mdi", "G53 G0 X10 Y-20 Z30 A-90 C270")
        assert (await other.ask("state"))["position"] == pytest.approx([10.0, -20.0, 30.0, -90.0, 270.0], abs=1e-6)
        assert (await nc.ask("state"))["position"][3] == 0.0
    assert other.process.returncode == 0
    assert not (folder / "linuxcnc.lock").exists()
    await nc.ask("mdi", "G53 G0 A10")
    assert (await nc.ask("state"))["position"][3] == pytest.approx(10.0, abs=1e-6)
