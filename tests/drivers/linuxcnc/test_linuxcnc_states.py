"""Some of the starting states of tests.benches.linuxcnc_states. Needs Debian's linuxcnc-uspace."""

from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from drivers.nc import ProbingState
from tests.benches.linuxcnc_bench import AgentBench
from tests.benches.linuxcnc_states import bring_about, compared, cycle, refused, stateful

pytestmark = [pytest.mark.peer, pytest.mark.slow, pytest.mark.waits(40)]

STATES = (
    "T1 M6|G43.1 Z77|T2|G10 L2 P9 X5 Y6 Z-7 A2 C3 R45|G59.3|G92 X1 Y2|G92.2|G64 P0.01 Q0.004|F12.34|G93|G91|G18|G7",
    "T1 M6|G43|G43.2 H2|T0|G10 L2 P2 X1 R-12.3456|G55|G92 X1 Y2 C4|G20|G61.1|G95 F0.0625|G90.1|G99|M49|M4 S1234.5|M7",
)


@pytest.fixture
async def bench(tmp_path: Path) -> AsyncIterator[AgentBench]:
    async with stateful(tmp_path) as it:
        yield it


async def test_everything_in_force_comes_back_and_what_cannot_be_probed_is_refused_before_it_moves(
    bench: AgentBench,
) -> None:
    for number, blocks in enumerate(STATES, start=1):
        status, changed = await compared(bench, {"all": blocks.replace("|", "\n")}, number)
        assert status.state is ProbingState.DONE, status
        assert changed == {}, blocks
    for name, (status, same) in (await refused(bench, len(STATES))).items():
        assert status.state is ProbingState.REFUSED, (name, status)
        assert same, name


async def test_with_cutter_compensation_the_request_waits_for_a_later_safe_point(bench: AgentBench) -> None:
    await bring_about(bench, {"contour": "T1 M6\nG43\nG1 F600\nG41 D1"})
    before = await sampled_position(bench)
    await bench.nc.request_probing(1)
    await bench.operator.ask("mdi", "o<talc_safe_point> call")
    assert (await bench.nc.probing_status(1)).state is ProbingState.REQUESTED
    assert await sampled_position(bench) == before
    await bench.operator.ask("mdi", "G40")
    await bench.nc.withdraw_probing(1)
    assert (await cycle(bench, 2)).state is ProbingState.DONE


async def sampled_position(bench: AgentBench) -> list[float]:
    return list((await bench.operator.ask("state"))["position"])
