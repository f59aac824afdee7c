"""The driver against another maker's OPC UA stack (node-opcua), so that two mistakes of one library cannot agree."""

import asyncio
from contextlib import AbstractAsyncContextManager
from pathlib import Path

import pytest

from drivers.base import ConnectError, DriverError, Refused, SystemClock, WrongDevice
from drivers.nc import OperatingMode, ProbingState, ProgramState
from drivers.sinumerik.control import Sinumerik
from drivers.sinumerik.settings import Paths, SinumerikSettings
from tests.benches.node_opcua_site import TIMEOUT_S, secured
from tests.benches.npm_peer import node_with, running

pytestmark = pytest.mark.peer


@pytest.fixture(scope="module")
def node() -> str:
    return node_with("node_opcua", "node-opcua")


def peer(node: str, *arguments: Path) -> AbstractAsyncContextManager[tuple[str, asyncio.subprocess.Process]]:
    """The server with its URL."""
    return running(node, "node_opcua/server.js", *arguments)


async def done(nc: Sinumerik, number: int) -> tuple[tuple[float, float, float], ...]:
    async with asyncio.timeout(60.0):
        while (status := await nc.probing_status(number)).state is not ProbingState.DONE:
            assert status.centres_mm is None
            await asyncio.sleep(0.02)
    assert status.centres_mm is not None
    return status.centres_mm


async def works(nc: Sinumerik) -> None:
    """Everything a NumericalControl does, once."""
    snapshot = await nc.snapshot()
    assert snapshot.positions == {"X": 10.5, "Y": -20.25, "Z": 150.0, "A": 30.0, "C": 270.0}
    assert snapshot.states["speed_X"] == 720.0
    assert snapshot.states["speed_C"] == 2.0
    assert (snapshot.mode, snapshot.program) == (OperatingMode.AUTO, ProgramState.RUNNING)
    assert snapshot.alarms == ()
    for number in (41, 42):
        await nc.request_probing(number)
        centres = await done(nc, number)
        assert len(centres) == 6
        assert centres[5] == pytest.approx((120 + number * 1e-4, 80 + number * 1e-4, number * 1e-4), abs=1e-9)
    with pytest.raises(Refused, match="request number 42"):
        await nc.request_probing(42)
    await nc.write_compensation((1.5, -2.5, 3.5))
    assert await nc.read_compensation() == pytest.approx((1.5, -2.5, 3.5))


@pytest.mark.parametrize("subscribe_s", [0.05])
async def test_in_the_clear_polling_and_subscribing(node: str, tmp_path: Path, subscribe_s: float) -> None:
    async with peer(node, tmp_path) as (url, _):
        nc = Sinumerik(
            SinumerikSettings(security="none", timeout_s=TIMEOUT_S, url=url, subscribe_s=subscribe_s), SystemClock()
        )
        await nc.connect()
        await works(nc)
        await nc.close()


async def test_signed_and_encrypted(node: str, tmp_path: Path) -> None:
    site = await secured(tmp_path, "gateway", "stranger")
    async with peer(node, *site.arguments) as (url, _):
        nc = Sinumerik(site.settings(url), SystemClock())
        await nc.connect()
        await works(nc)
        await nc.close()
        with pytest.raises(DriverError, match="the gateway's certificate"):
            await Sinumerik(site.settings(url, "stranger"), SystemClock()).connect()
        site.password.write_text("guess\n")
        with pytest.raises(Refused, match="refuses user 'gateway'"):
            await Sinumerik(site.settings(url), SystemClock()).connect()
        in_the_clear = Sinumerik(SinumerikSettings(security="none", timeout_s=TIMEOUT_S, url=url), SystemClock())
        with pytest.raises(DriverError, match="Basic256Sha256"):
            await in_the_clear.connect()


async def test_killed_in_a_session(node: str, tmp_path: Path) -> None:
    async with peer(node, tmp_path) as (url, process):
        nc = Sinumerik(
            SinumerikSettings(security="none", timeout_s=TIMEOUT_S, url=url, subscribe_s=0.05), SystemClock()
        )
        await nc.connect()
        process.kill()
        await process.wait()
        with pytest.raises(ConnectError):
            await nc.write_compensation((1.0, 1.0, 1.0))
        with pytest.raises(ConnectError):
            await nc.connect()


async def test_what_the_server_does_not_have_or_does_not_let_us_write(node: str, tmp_path: Path) -> None:
    async with peer(node, tmp_path) as (url, _):
        wrong = SinumerikSettings(
            security="none", timeout_s=TIMEOUT_S, url=url, nodes=Paths(tool="/Channel/State/actTNo[u1]")
        )
        with pytest.raises(WrongDevice, match=r"actTNo\[u1\] does not exist"):
            await Sinumerik(wrong, SystemClock()).connect()
        # tanβ is shown, not writable
        locked = SinumerikSettings(
            security="none", timeout_s=TIMEOUT_S, url=url, nodes=Paths(k0="/NC/_N_AX_SEA_ACX/$SA_TEMP_COMP_SLOPE[u{n}]")
        )
        nc = Sinumerik(locked, SystemClock())
        await nc.connect()
        with pytest.raises(Refused, match=r"SLOPE\[u1\].*SeaWrite"):
            await nc.write_compensation((1.0, 1.0, 1.0))
        await nc.close()
