"""Of two gateways only one writes to a control, on the wire to an emulated one."""

from pathlib import Path

import pytest

from tests.benches.nc_link_bench import decision
from tests.benches.wire_bench import wire_bench

pytestmark = pytest.mark.simulated_time


@pytest.mark.slow
async def test_the_second_of_two_gateways_is_refused_until_the_first_is_gone(tmp_path: Path) -> None:
    async with wire_bench(tmp_path) as bench:
        async with bench.running(bench.link(owner=7), stop=True) as first:
            first.follow(decision(6.0))
            await bench.clock.run_until(8.0)
            count = len(bench.writes)
            async with bench.running(bench.link(owner=8)) as second:
                second.follow(decision(-6.0))
                await bench.clock.run_until(25.0)
                assert bench.in_force_um == pytest.approx((0.0, 0.0, 6.0))
                assert any("belongs to gateway 7" in notice for notice in bench.notices)
                assert not any(write.written for write in bench.writes[count:] if write.step.offsets_um[2] < 0)
        async with bench.running(bench.link(owner=8)) as second:
            second.follow(decision(-6.0))
            await bench.clock.run_until(bench.clock.monotonic() + 20.0)
            assert bench.in_force_um == pytest.approx((0.0, 0.0, -6.0))
        bench.assert_never_stepped()


async def test_a_restart_goes_on_at_once_and_a_copy_of_the_computer_is_another_gateway(tmp_path: Path) -> None:
    async with wire_bench(tmp_path) as bench:
        async with bench.running(bench.link(owner=7)) as first:
            first.follow(decision(6.0))
            await bench.clock.run_until(8.0)
        # Killed: the control believes that it is alive. The next run has read its owner number in the database.
        async with bench.running(bench.link(owner=8, predecessor=7)) as restarted:
            restarted.follow(decision(6.0))
            await bench.clock.run_until(12.0)
            assert bench.in_force_um == pytest.approx((0.0, 0.0, 6.0))
            # The copy, started now, has read the same in its database.
            async with bench.running(bench.link(owner=9, predecessor=7)) as copy:
                copy.follow(decision(-6.0))
                await bench.clock.run_until(30.0)
                assert bench.in_force_um == pytest.approx((0.0, 0.0, 6.0))
                assert any("belongs to gateway 8" in notice for notice in bench.notices)
        bench.assert_never_stepped()
