"""Whatever the agent's bytes and values are, the driver returns what its interface says or raises a driver's error."""

import asyncio
import random
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.agent.control import AgentControl
from drivers.base import BadAnswer, SystemClock
from drivers.nc import NineErrors, NotSendable
from tests.benches.fake_agent import Agent, agent_and_driver, serving
from tests.benches.refusals import refusing
from tests.benches.spoilt_agent import STATUS, ask_everything, ask_spoilt_agent, connected

pytestmark = pytest.mark.simulated_time

LEAF = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5)
ANY = st.recursive(LEAF, lambda inner: st.lists(inner, max_size=7) | st.dictionaries(st.text(max_size=5), inner))
CHANGED = st.builds(lambda name, value: STATUS | {name: value}, st.sampled_from(sorted(STATUS)), ANY)
DONE = st.builds(lambda centres, spread: {"state": "done", "centres": centres, "spread": spread}, ANY, ANY)


@pytest.mark.slow
def test_any_signed_values_raise_nothing_but_driver_errors(tmp_path: Path) -> None:
    agent = Agent()
    with asyncio.Runner() as runner:

        async def tried(status: object, offsets: object, probing: object, heard: object) -> None:
            agent.answers = {"status": STATUS, "read": [0.0, 0.0, 0.0]}
            async with serving(agent, tmp_path, timeout_s=0.02) as to:
                nc = AgentControl(to, SystemClock())
                await connected(nc)
                agent.answers = {
                    "status": status, "read": offsets, "errors": offsets, "probing": probing, "heartbeat": heard
                }  # fmt: skip
                await ask_everything(nc)
                await nc.close()

        @settings(max_examples=40)
        @given(ANY | CHANGED, ANY, ANY | DONE, ANY)
        def any_values(status: object, offsets: object, probing: object, heard: object) -> None:
            runner.run(tried(status, offsets, probing, heard))

        any_values()


async def test_damaged_bytes_raise_nothing_but_driver_errors(tmp_path: Path) -> None:
    await ask_spoilt_agent(tmp_path, random.Random(1), 25)


GREETINGS = [
    (["read", "status"], None),  # earlier agents named their commands
    ({"capabilities": ["probe", "shift"]}, None),
    ({"capabilities": ["shift", "errors"], "reach_mm": [300, 400.5]}, (300.0, 400.5)),
]


@pytest.mark.parametrize(("greeting", "reach"), GREETINGS)
async def test_an_agent_that_takes_the_nine_errors_says_so(
    greeting: object, reach: tuple[float, float] | None, tmp_path: Path
) -> None:
    async with agent_and_driver(tmp_path) as (agent, nc):
        assert nc.error_reach_mm is None
        agent.answers[""] = greeting
        await nc.connect()
        assert nc.error_reach_mm == reach


@pytest.mark.parametrize("reach", [None, [300.0], [300.0, 0.0], [300.0, "far"], [300.0, -4.0], "far"])
async def test_an_agent_that_takes_the_nine_errors_says_how_far_its_tools_reach(reach: object, tmp_path: Path) -> None:
    async with agent_and_driver(tmp_path) as (agent, nc):
        agent.answers[""] = {"capabilities": ["errors"], "reach_mm": reach}
        with pytest.raises(BadAnswer, match="reach_mm"):
            await nc.connect()


TELLS_IN_FORCE = [
    {"capabilities": ["errors"], "reach_mm": [300.0, 400.0]},
    {"version": 3, "capabilities": ["probe", "shift"], "poses": 6},
]


@pytest.mark.parametrize("greeting", TELLS_IN_FORCE, ids=["takes the nine errors", "speaks version 3"])
async def test_a_cycle_of_such_an_agent_is_done_with_what_was_in_force(greeting: object, tmp_path: Path) -> None:
    async with agent_and_driver(tmp_path) as (agent, nc):
        done = {"state": "done", "centres": [[0.0, 0.0, 0.0]] * 6, "spread": 0.0}
        agent.answers |= {"": greeting, "probing": done}
        await nc.connect()
        with pytest.raises(BadAnswer, match="offsets during the cycle"):
            await nc.probing_status(7)
        agent.answers["probing"] = {**done, "in_force": [1.0, -2.0, 3.0]}
        assert (await nc.probing_status(7)).in_force_um == (1.0, -2.0, 3.0)


@pytest.mark.parametrize("centres", [[], [[0.0, 0.0, 0.0]] * 5, [[0.0, 0.0, 0.0]] * 7, None])
async def test_a_cycle_without_a_centre_for_each_pose_is_no_result(centres: object, tmp_path: Path) -> None:
    async with agent_and_driver(tmp_path) as (agent, nc):
        agent.answers["probing"] = {"state": "done", "centres": centres, "spread": 0.0, "in_force": [0.0] * 3}
        with pytest.raises(BadAnswer, match="cycle 7 is done without 6 centres"):
            await nc.probing_status(7)


async def test_errors_with_a_bound_beyond_the_agent_s_are_never_sent(tmp_path: Path) -> None:
    async with agent_and_driver(tmp_path) as (agent, nc):
        agent.answers[""] = {"capabilities": ["errors"], "reach_mm": [300.0, 400.0], "bound_um": 49.99999999}
        agent.answers |= {"write_errors": None, "errors": [0.0] * 9}
        await nc.connect()
        await nc.write_errors(NineErrors((0.0,) * 9, 120.0, (50.0, 50.0, 50.0)))
        with refusing(NotSendable, "agent_bound bound_um=50.1 most_um=49.99999999"):
            await nc.write_errors(NineErrors((0.0,) * 9, 120.0, (50.0, 50.0, 50.1)))


@pytest.mark.parametrize(
    "errors",
    [
        NineErrors((0.0,) * 8, 120.0, (50.0, 50.0, 50.0)),
        NineErrors((0.0,) * 8 + (float("nan"),), 120.0, (50.0, 50.0, 50.0)),
        NineErrors((0.0,) * 8 + (501.0,), 120.0, (50.0, 50.0, 50.0)),
        NineErrors((0.0,) * 9, float("inf"), (50.0, 50.0, 50.0)),
        NineErrors((0.0,) * 9, 120.0, (50.0, 50.0, float("nan"))),
    ],
)
async def test_errors_that_are_no_numbers_or_too_large_are_never_sent(errors: NineErrors, tmp_path: Path) -> None:
    async with agent_and_driver(tmp_path) as (agent, nc):
        heard = len(agent.heard)
        with pytest.raises(NotSendable, match="nothing was sent"):
            await nc.write_errors(errors)
        assert len(agent.heard) == heard
