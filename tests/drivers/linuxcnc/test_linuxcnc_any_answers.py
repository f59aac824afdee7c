"""Whatever the agent's bytes and values are, the driver returns what its interface says or raises a driver's error."""

import asyncio
import random
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.base import DriverError, NoAnswer, SystemClock
from drivers.linuxcnc import LinuxCnc
from drivers.nc import WatchdogTerms
from tests.benches.cut_line import line_to
from tests.benches.linuxcnc_fake_agent import Agent, serving

pytestmark = pytest.mark.simulated_time

STATUS = {
    "positions": dict.fromkeys("XYZAC", 1.0), "states": {}, "mode": "auto", "program": "running", "tool": 1,
    "probe": False, "estop": False, "on": True, "homed": True, "probing": False, "cannot_probe": "",
}  # fmt: skip
ANSWERS = {"status": STATUS, "read": [0.0, 0.0, 0.0], "probing": {"state": "idle"}, "heartbeat": True}
LEAF = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5)
ANY = st.recursive(LEAF, lambda inner: st.lists(inner, max_size=7) | st.dictionaries(st.text(max_size=5), inner))
CHANGED = st.builds(lambda name, value: STATUS | {name: value}, st.sampled_from(sorted(STATUS)), ANY)
DONE = st.builds(lambda centres, spread: {"state": "done", "centres": centres, "spread": spread}, ANY, ANY)


async def connected(nc: LinuxCnc) -> None:
    """The timeouts here are so short that a busy computer misses one now and then."""
    for _ in range(500):
        with suppress(NoAnswer):
            await nc.connect()
            return
    raise AssertionError("the agent does not answer")


async def ask_everything(nc: LinuxCnc) -> None:
    for ask in (
        lambda: nc.snapshot(), lambda: nc.read_compensation(), lambda: nc.probing_status(7),
        lambda: nc.request_probing(8), lambda: nc.withdraw_probing(8), lambda: nc.heartbeat(1),
        lambda: nc.claim(1, WatchdogTerms(5.0, 1.0)), lambda: nc.release(1),
        lambda: nc.write_compensation((0.0, 0.0, 0.0)),
    ):  # fmt: skip
        with suppress(DriverError):
            await ask()


def test_any_signed_values_raise_nothing_but_driver_errors(tmp_path: Path) -> None:
    agent = Agent()
    with asyncio.Runner() as runner:

        async def tried(status: object, offsets: object, probing: object, heard: object) -> None:
            agent.answers = {"status": STATUS, "read": [0.0, 0.0, 0.0]}
            async with serving(agent, tmp_path, timeout_s=0.02) as to:
                nc = LinuxCnc(to, SystemClock())
                await connected(nc)
                agent.answers = {"status": status, "read": offsets, "probing": probing, "heartbeat": heard}
                await ask_everything(nc)
                await nc.close()

        @settings(max_examples=40)
        @given(ANY | CHANGED, ANY, ANY | DONE, ANY)
        def any_values(status: object, offsets: object, probing: object, heard: object) -> None:
            runner.run(tried(status, offsets, probing, heard))

        any_values()


async def test_damaged_bytes_raise_nothing_but_driver_errors(tmp_path: Path) -> None:
    agent, draw = Agent(), random.Random(1)
    agent.answers = dict(ANSWERS)

    def spoil(data: bytes) -> bytes:
        spoilt = bytearray(data)
        match draw.randrange(5):
            case 0:
                spoilt[draw.randrange(len(data))] = draw.randrange(256)
            case 1:
                del spoilt[draw.randrange(len(data)) :]
            case 2:
                spoilt += data
            case 3:
                at = draw.randrange(len(data))
                spoilt[at:at] = draw.randbytes(20)
            case _:
                pass
        return bytes(spoilt)

    async with serving(agent, tmp_path) as to, line_to(f"tcp:{to.port}") as (line, joined):
        nc = LinuxCnc(to.model_copy(update={"port": int(joined.rsplit(":", 1)[1]), "timeout_s": 0.1}), SystemClock())
        for _ in range(25):
            line.spoil = None
            await connected(nc)
            line.spoil = spoil
            await ask_everything(nc)
            with suppress(DriverError):
                await nc.connect()
        await nc.close()
