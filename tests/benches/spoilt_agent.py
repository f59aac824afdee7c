"""Changes an agent's answers, by a seed, and asks it everything nevertheless."""

import random
from contextlib import suppress
from pathlib import Path

from drivers.agent.control import AgentControl
from drivers.base import DriverError, NoAnswer, SystemClock
from drivers.nc import NineErrors, WatchdogTerms
from tests.benches.cut_wire import wire_to
from tests.benches.fake_agent import Agent, serving

STATUS = {
    "positions": dict.fromkeys("XYZAC", 1.0), "states": {}, "mode": "auto", "program": "running", "tool": 1,
    "probe": False, "estop": False, "on": True, "homed": True, "probing": False, "cannot_probe": "",
}  # fmt: skip
ANSWERS = {"status": STATUS, "read": [0.0, 0.0, 0.0], "probing": {"state": "idle"}, "heartbeat": True}


async def connected(nc: AgentControl) -> None:
    """The timeouts here are so short that a busy computer misses one now and then."""
    for _ in range(500):
        with suppress(NoAnswer):
            await nc.connect()
            return
    raise AssertionError("the agent does not answer")


async def ask_everything(nc: AgentControl) -> None:
    for ask in (
        lambda: nc.snapshot(), lambda: nc.read_compensation(), lambda: nc.probing_status(7),
        lambda: nc.request_probing(8), lambda: nc.withdraw_probing(8), lambda: nc.heartbeat(1),
        lambda: nc.claim(1, WatchdogTerms(5.0, 1.0)), lambda: nc.release(1),
        lambda: nc.write_compensation((0.0, 0.0, 0.0)), lambda: nc.read_errors(120.0),
        lambda: nc.write_errors(NineErrors((0.0,) * 9, 120.0, (50.0, 50.0, 50.0))),
    ):  # fmt: skip
        with suppress(DriverError):
            await ask()


async def ask_spoilt_agent(folder: Path, draw: random.Random, rounds: int) -> None:
    """Ask every question this many times, with all answers spoilt. Raises whatever is not a DriverError."""
    agent = Agent()
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

    async with serving(agent, folder) as to, wire_to(f"tcp:{to.port}") as (wire, joined):
        nc = AgentControl(
            to.model_copy(update={"port": int(joined.rsplit(":", 1)[1]), "timeout_s": 0.1}), SystemClock()
        )
        for _ in range(rounds):
            wire.spoil = None
            await connected(nc)
            wire.spoil = spoil
            await ask_everything(nc)
            with suppress(DriverError):
                await nc.connect()
        await nc.close()
