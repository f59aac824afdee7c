"""Decisions reach a subscriber in another process while the gateway learns: the bench of docs/results.md, shorter."""

import pytest

from tests.benches.tick_latency import STEP_S, WAYS, run_ticks


@pytest.mark.slow
@pytest.mark.realtime
@pytest.mark.parametrize("way", WAYS)
def test_every_decision_comes_within_its_step_while_the_gateway_learns(way: str) -> None:
    """Tolerance: half a step of a second, for the median. On an idle computer it is about a tenth of that."""
    found = run_ticks(way, 12.0)
    assert len(found.latencies_s) >= 10
    assert found.missing == 0
    assert min(found.latencies_s) > 0.0
    assert found.percentile_ms(50) < 1e3 * STEP_S / 2
    assert found.trained_share > 0.5 if way == "models" else found.learnt >= 3
