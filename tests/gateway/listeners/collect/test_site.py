"""A small site whose router, collector and gateways are killed: the bench of docs/collect.md, with real processes."""

import pytest

from tests.benches.site import of_rows, run_site


@pytest.mark.slow
def test_nothing_is_lost_or_kept_twice_when_router_collector_and_gateways_are_killed() -> None:
    found = run_site(gateways=2, keys=3, passes=of_rows(240), every_s=0.2, read_every_s=0.05)
    assert found.stored > 240 // 2 + 240 // 5
    assert (found.lost, found.doubled_or_moved) == (0, 0)
