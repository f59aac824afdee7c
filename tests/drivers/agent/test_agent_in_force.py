"""When a write of the agent's driver returns: what is then read back must be what the gateway compares it with."""

import json
from pathlib import Path

import pytest

from drivers.nc import NineErrors
from tests.benches.fake_agent import agent_and_driver

pytestmark = pytest.mark.simulated_time

BOUND_UM = (50.0, 50.0, 50.0)
WANTED = [0.0] * 5 + [5.0] + [0.0] * 3
NEAR = [0.0] * 5 + [5.0 - 9e-4] + [0.0] * 3
"""With ER0T at 120 mm, 0.08 µm beside the wanted shift at a reach of 10.9 m; the gateway lets 0.05 µm pass."""


@pytest.mark.parametrize(
    ("seen", "read_back"),
    [([[0.0] * 9, NEAR, WANTED], WANTED), ([NEAR, NEAR], NEAR)],
    ids=["a control that slews is waited for", "a control that rounds is believed once it stands"],
)
async def test_errors_are_in_force_when_they_are_reached_or_stand_near(
    seen: list[list[float]], read_back: list[float], tmp_path: Path
) -> None:
    async with agent_and_driver(tmp_path) as (agent, nc):
        answers = [None, *seen]
        agent.says = [
            agent.signed(json.dumps({"answer": answer}).encode(), ahead=ahead) for ahead, answer in enumerate(answers)
        ]
        agent.answers["errors"] = read_back
        asked = len(agent.heard)
        await nc.write_errors(NineErrors(tuple(WANTED), 120.0, BOUND_UM))
        assert [message["do"] for message in agent.heard[asked:]] == ["write_errors", *["errors"] * len(seen)]
        assert await nc.read_errors(120.0) == tuple(read_back)
