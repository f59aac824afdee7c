"""The whole gateway, killed at any moment while it compensates. `tests.benches.gateway_kills` does it for longer."""

import asyncio
from contextlib import AsyncExitStack
from pathlib import Path
from tempfile import mkdtemp

import pytest

from simulators.nc.watchdog import Logged
from tests.benches.gateway_kills import PERIOD_S, RATE_UM_PER_S, gateways_killed, judged


async def test_a_gateway_killed_at_any_moment_makes_no_step(tmp_path: Path) -> None:
    async with AsyncExitStack() as stack:
        stack.push_async_callback(asyncio.get_running_loop().shutdown_default_executor)
        for _ in range(3):
            found = await gateways_killed(8, Path(mkdtemp(dir=tmp_path)))
            judged(found.log)
            assert found.moved >= found.count // 3
            assert found.reached_um > RATE_UM_PER_S * PERIOD_S, "some lived for more than one step of Z"
            assert found.whole
            if any(entry.ramped for entry in found.log):
                return
            # Seldom, all kills fall where no offset is left that the watchdog would take back.
        pytest.fail("the watchdog ramped in none of three runs")


@pytest.mark.parametrize(
    "log",
    [
        [Logged(1.0, (0.0, 0.0, 0.0041), ramped=False)],
        [Logged(1.0, (0.0, 0.0065, 0.0), ramped=True)],
        [
            Logged(1.0, (0.002, 0.0, 0.0), ramped=False),
            Logged(1.7, (0.001999, 0.0, 0.0), ramped=True),
            Logged(2.1, (0.004, 0.0, 0.0), ramped=False),
        ],
        [Logged(1.0 + 0.005 * i, (0.0015 * (i - 4), 0.0, 0.0), ramped=False) for i in range(9)],
    ],
)
def test_the_judge_can_find_a_step(log: list[Logged]) -> None:
    with pytest.raises(AssertionError):
        judged(log)


def test_the_judge_allows_for_a_ramp_that_begins_while_a_write_is_under_way() -> None:
    judged(
        [
            Logged(1.0, (0.002, 0.0, 0.0), ramped=False),
            Logged(1.6, (0.001999, 0.0, 0.0), ramped=True),
            Logged(1.61, (0.004, 0.0, 0.0), ramped=False),
        ]
    )
