"""A value that a control reports and its driver cannot read is named, and the rest of the snapshot is used."""

from dataclasses import replace

from drivers.nc import NcSnapshot
from tests.benches.nc_link_bench import LinkBench, answer_wrongly, decision


async def test_values_that_are_not_known_are_reported_once_and_again_when_they_are_known() -> None:
    bench = LinkBench("compensate")
    asked = 0

    def changing(snapshot: NcSnapshot) -> NcSnapshot:
        nonlocal asked
        asked += 1
        return replace(snapshot, not_known={"coolant": f"'MIST-{asked}' (data item flood of mill)"})

    async with bench.running():
        repair = answer_wrongly(bench, "snapshot", changing)
        bench.link.follow(decision(6.0))
        await bench.clock.run_until(50.0)
        told = (
            "NC: not known to the gateway: coolant = 'MIST-1' (data item flood of mill); correct [nc] if it names the "
            "wrong item, else please report the word"
        )
        assert asked > 10
        assert bench.notices == [told], "not with each value"
        assert bench.control.in_force == (0.0, 0.0, 6.0), "positions and all else count"
        repair()
        await bench.clock.run_until(60.0)
        assert bench.notices == [told, "NC: all its values are known to the gateway again"]
