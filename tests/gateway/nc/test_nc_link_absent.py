"""A control that cannot be reached, again and again: each cause is reported once, and not without end."""

from dataclasses import replace

from gateway.nc.problems import still_wrong
from tests.benches.nc_link_bench import LinkBench, answer_wrongly


async def test_each_new_cause_while_it_is_not_connected_is_reported_once() -> None:
    bench = LinkBench("compensate")
    async with bench.following(4.0, until_s=5.0):
        bench.control.absent = True
        await bench.clock.run_until(15.0)
        bench.control.absent, bench.control.owner = False, 99  # another gateway has come meanwhile
        await bench.clock.run_until(200.0)
        assert [notice for notice in bench.notices if "no answer" in notice] == bench.notices[:1]
        assert [notice for notice in bench.notices if "gateway 99" in notice] == bench.notices[1:]
        assert len(bench.notices) == 2
        assert still_wrong(bench.notices) == (bench.notices[1],)
        bench.control.owner = 0
        await bench.clock.run_until(300.0)
    assert bench.notices[2:] == ["NC: connected again"]
    assert still_wrong(bench.notices) == ()


async def test_an_intermittent_connection_is_not_reported_without_end() -> None:
    bench = LinkBench("monitor")
    async with bench.running():
        for turn in range(200):
            bench.control.absent = turn % 2 == 1
            await bench.clock.run_until(5.0 * (turn + 1))
        assert len(bench.notices) == 7, "three with their ends, then that it is intermittent"
        assert "intermittent" in bench.notices[-1]
        bench.control.absent = False
        await bench.clock.run_until(1200.0)
    assert bench.notices[7:] == ["NC: connected again"]


async def test_a_control_that_stays_away_is_tried_ever_less_often() -> None:
    bench = LinkBench("monitor")
    bench.control.absent = True
    tried_before = bench.link.tried
    async with bench.running():
        await bench.clock.run_until(600.0)
        assert (tried_before, bench.link.tried) == (False, True)
        tried = bench.control.closed
        await bench.clock.run_until(900.0)
    assert tried < 60
    assert 5 <= bench.control.closed - tried < 30


async def test_the_states_of_a_control_whose_values_are_frozen_are_passed_on_no_more() -> None:
    bench = LinkBench("monitor", frozen_after_s=20.0)
    async with bench.running():
        await bench.clock.run_until(5.0)
        assert bench.states
        assert set(bench.states[-1]) == {"coolant", "spindle_speed"}
        repair = answer_wrongly(bench, "snapshot", lambda s: replace(s, states=dict(s.states) | {"speed_X": 500.0}))
        await bench.clock.run_until(40.0)
        good = len(bench.states)
        await bench.clock.run_until(60.0)
        assert len(bench.states) == good
        repair()
        await bench.clock.run_until(70.0)
        assert len(bench.states) >= good + 9
