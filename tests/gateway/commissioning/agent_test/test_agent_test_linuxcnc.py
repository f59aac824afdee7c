"""The real LinuxCNC's agent passes every clause of docs/agent.md that it offers. Needs Debian's linuxcnc-uspace."""

from pathlib import Path

import pytest

from gateway.commissioning.agent_test.clause import ClauseResult, Moves
from gateway.commissioning.agent_test.clauses import run_clauses
from gateway.commissioning.agent_test.connection import AgentUnderTest
from simulators.linuxcnc.machine import HURRY
from tests.benches.linuxcnc_bench import ANSWER_S, KEY, running

pytestmark = [pytest.mark.peer, pytest.mark.slow, pytest.mark.waits(100)]


async def test_linuxcnc_s_agent_passes_every_clause_that_it_offers(tmp_path: Path) -> None:
    tools = "T99 P99 Z40 D6 ;probe\nT5 P5 Z17 D6 ;mill\n"
    async with running(
        tmp_path, {**HURRY, "SLEW": 1.0, "FEED": 300, "FIND_FEED": 2000}, sphere=True, tools=tools
    ) as bench:
        await bench.operator.ask("hal", "setp", "talc.may-start", "1")
        await bench.nc.close()
        target = AgentUnderTest("127.0.0.1", bench.settings.port, KEY.encode(), ANSWER_S)
        outcomes = [o async for o in run_clauses(target, (Moves.OFFSETS, Moves.CYCLE), cycle_limit_s=300.0)]
        failed = [(o.clause.name, o.came) for o in outcomes if o.result is ClauseResult.FAILED]
        assert failed == []
        not_offered = [o.clause.name for o in outcomes if o.result is ClauseResult.NOT_OFFERED]
        assert not_offered == ["slopes-come-into-force"]
        await bench.nc.connect()
