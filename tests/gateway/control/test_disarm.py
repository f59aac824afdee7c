"""The commands disarm, arm and reload: what each does, what survives a restart, and that nothing arms too much."""

import asyncio
from pathlib import Path

import pytest

from drivers.nc import ProbingState, RequestStatus
from gateway.acquisition.reload import ReloadError
from gateway.config.file import parse
from gateway.model.codes import NoticeCode
from gateway.model.commands import Command, CommandName, Disarmed
from gateway.model.compensation import Source
from gateway.model.events import CommandGiven
from gateway.model.text import Text, plain
from gateway.storage.mending import Known, mend
from gateway.storage.store import Store
from talc.frame import EventKind
from tests.benches.commanded import CONFIG, NOWHERE, STEP_S, commanded
from tests.benches.nc_link_bench import LinkBench
from tests.benches.restarted import restarted
from tests.benches.stepped_clock import EPOCH

DISARM, ARM, PAUSE, RESUME, MEASURE, RELOAD = (
    CommandName.DISARM, CommandName.ARM, CommandName.PAUSE, CommandName.RESUME, CommandName.MEASURE, CommandName.RELOAD,
)  # fmt: skip


@pytest.mark.parametrize("when_stale", ["zero", "hold"])
async def test_disarmed_the_offsets_ramp_to_zero_whatever_is_declared_until_it_is_armed(when_stale: str) -> None:
    bench = LinkBench("compensate", when_stale=when_stale)
    async with commanded(bench, follow=6.0) as at:
        await bench.clock.run_until(20.0)
        assert bench.control.in_force == (0.0, 0.0, 6.0)
        disarmed = await at.give(DISARM)
        assert (disarmed.accepted, bench.link.disarmed) == (True, Disarmed("anna", disarmed.time))
        await bench.clock.run_until(23.0)
        assert 2.0 <= bench.control.in_force[2] <= 4.0, "on its way at 1 µm/s"
        await bench.clock.run_until(200.0)
        assert bench.control.in_force == (0.0, 0.0, 0.0)
        assert bench.steps[-1].step.source is Source.DISARMED
        for name in (PAUSE, RESUME):
            await at.give(name, "ben")
        await bench.clock.run_until(220.0)
        assert bench.control.in_force == (0.0, 0.0, 0.0), "the end of a pause arms nothing"
        again = await at.give(DISARM, "ben")
        assert again.text == f"the gateway was {Disarmed('anna', disarmed.time)} already"
        assert (await at.give(ARM, "ben")).text.startswith(
            "armed again as the configuration says; it was disarmed by anna"
        )
        await bench.clock.run_until(240.0)
        assert bench.control.in_force == (0.0, 0.0, 6.0)
        assert at.largest_step_um() <= 1.0


async def test_armed_again_a_pause_stays() -> None:
    bench = LinkBench("compensate")
    async with commanded(bench, follow=6.0) as at:
        await bench.clock.run_until(20.0)
        for name in (PAUSE, DISARM):
            await at.give(name)
        armed = await at.give(ARM)
        assert "; nothing is corrected, because the compensation is paused by anna" in armed.text
        await bench.clock.run_until(60.0)
        assert bench.control.in_force == (0.0, 0.0, 0.0)
        assert bench.steps[-1].step.source is Source.PAUSED


async def test_arming_never_arms_more_than_the_configuration_nor_what_has_disarmed_itself() -> None:
    unarmed = LinkBench("advise", armed=False)
    async with commanded(unarmed, follow=6.0) as at:
        await at.give(DISARM)
        text = (await at.give(ARM)).text
        assert "nothing is written, because the compensation is not armed" in text
        assert "nothing is measured, because probing is not armed" in text
        assert not (await at.give(MEASURE)).accepted
        await unarmed.clock.run_until(400.0)
    assert (unarmed.control.writes, unarmed.control.beats, unarmed.control.requests) == ([], [], [])

    bench = LinkBench("compensate")
    async with commanded(bench, follow=6.0) as at:
        await bench.clock.run_until(20.0)
        bench.control.in_force = (0.0, 0.0, 3.0)  # somebody else's
        await bench.clock.run_until(25.0)
        many = len(bench.control.writes)
        assert not bench.link.armed
        assert "disarmed itself" in (await at.give(ARM)).text
        await bench.clock.run_until(100.0)
        assert (bench.link.armed, len(bench.control.writes)) == (False, many)


async def test_disarmed_no_cycle_is_requested_and_one_that_waits_is_withdrawn() -> None:
    bench = LinkBench("monitor")
    async with commanded(bench) as at:
        await bench.clock.run_until(10.0)
        await at.give(MEASURE)
        await bench.clock.run_until(130.0)
        assert (bench.control.requests, bench.control.withdrawn) == ([41], [])
        await at.give(DISARM)
        await bench.clock.run_until(135.0)
        assert bench.control.withdrawn == [41]
        bench.control.answer = RequestStatus(0, ProbingState.DONE, NOWHERE)
        await bench.clock.run_until(STEP_S + 10.0)
        measure = await at.give(MEASURE)
        assert (measure.accepted, measure.text[:32]) == (False, "the gateway is disarmed by anna ")
        await bench.clock.run_until(2 * STEP_S)
        assert bench.control.requests == [41], "not even the other cycles of the reference"
        await at.give(ARM)
        await at.give(MEASURE)
        await bench.clock.run_until(3 * STEP_S + 1.0)
        assert len(bench.control.requests) > 1


async def test_a_measurement_that_waited_for_its_moment_is_not_requested_once_it_is_disarmed() -> None:
    bench = LinkBench("monitor")
    async with commanded(bench) as at:
        await bench.clock.run_until(10.0)
        await at.give(MEASURE)
        await at.give(DISARM)
        await bench.clock.run_until(STEP_S + 10.0)
        assert bench.control.requests == []
        assert any("disarmed by anna" in outcome.reason for outcome in at.told.outcomes)


async def test_a_disarming_survives_restarts_and_the_loss_of_the_database(tmp_path: Path) -> None:
    config = parse(CONFIG, tmp_path / "gateway.toml")
    path, bench = config.storage.path, LinkBench("compensate")

    async with commanded(bench, follow=6.0) as at:
        with Store(path, "first", bench.clock) as store:
            store.begin(config.canonical(), config.fingerprint(), "")
            answer = await at.give(DISARM)
            for each in (answer, await at.give(PAUSE), await at.give(RESUME), await at.give(ARM, refused="no")):
                store.record(CommandGiven(each))
    order = Disarmed("anna", answer.time)
    assert restarted(config).disarmed == order
    again = LinkBench("compensate", in_force=(0.0, 0.0, 4.0), disarmed=restarted(config).disarmed)
    async with commanded(again, follow=6.0) as at:
        await again.clock.run_until(60.0)
        assert again.control.in_force == (0.0, 0.0, 0.0)
        assert at.largest_step_um(begins=4.0) <= 1.0
        row = (answer.time.isoformat(), "disarm", "anna", 1, answer.text)
        for known in (Known(standing={DISARM: row}), Known()):
            mend(path, "a bit has flipped", EPOCH, known)
            assert restarted(config).disarmed == order
        with Store(path, "second", again.clock) as store:
            store.record(CommandGiven(await at.give(ARM, "ben")))
    assert restarted(config).disarmed is None


async def test_without_a_disk_disarming_counts_at_once_and_arming_does_not() -> None:
    bench = LinkBench("compensate")
    async with commanded(bench, follow=6.0) as at:
        await bench.clock.run_until(20.0)
        for _ in range(20):
            await at.give(RESUME)
        at.disk_fails = "database or disk is full"
        disarmed = await at.give(DISARM)
        assert (disarmed.accepted, disarmed.text[-24:]) == (True, "database or disk is full")
        bench.clock.spend(61.0)
        for name in (ARM, RELOAD):
            assert (await at.give(name)).text.startswith("it cannot be stored: database or disk is full")
        await bench.clock.run_until(160.0)
        assert bench.control.in_force == (0.0, 0.0, 0.0)


async def test_a_reload_is_answered_with_what_is_applied_or_with_what_needs_a_restart() -> None:
    bench = LinkBench("monitor")
    asked = 0

    async def reload() -> Text:
        nonlocal asked
        asked += 1
        if asked == 1:
            raise ReloadError(Text(NoticeCode.RELOAD_NEEDS_RESTART, sections=("[nc]", "[compensation]")))
        return plain("it is being applied")

    async with commanded(LinkBench("monitor")) as without:
        assert (await without.give(RELOAD)).text == "this gateway has no file to read again"
    async with commanded(bench, reload=reload) as at:
        refused = await at.give(RELOAD)
        assert (refused.accepted, refused.text) == (
            False,
            "not reloaded; the previous configuration stays in use: [nc], [compensation] changed: restart the gateway "
            "to apply it",
        )
        assert (await at.give(RELOAD)).accepted
        await at.give(RELOAD, "ben", refused="ben may not give this command")
        assert asked == 2
        given = [event.outcome.command for event in at.told.of(CommandGiven)]
        assert given == [*[Command(RELOAD, "anna")] * 2, Command(RELOAD, "ben")]
        assert len(at.told.texts(EventKind.COMMAND)) == 3


async def test_disarming_waits_for_no_other_command_and_counts_after_those_that_came_before_it() -> None:
    bench = LinkBench("compensate")
    async with commanded(bench, follow=6.0) as at:
        await at.give(DISARM)
        at.disk_waits = asyncio.Event()
        arm = asyncio.create_task(at.give(ARM, "ben"))
        await bench.clock.run_until(1.0)
        pause, disarm = (asyncio.create_task(at.give(name)) for name in (PAUSE, DISARM))
        await bench.clock.run_until(2.0)
        assert bench.link.paused is not None, "the disk is still waited for"
        assert not arm.done()
        at.disk_waits.set()
        answers = await asyncio.gather(arm, pause, disarm)
        assert [answer.accepted for answer in answers] == [True] * 3
        assert bench.link.disarmed is not None, "it was given last"
        given = [event.outcome for event in at.told.of(CommandGiven)]
        assert [outcome.command.name for outcome in given] == [DISARM, ARM, PAUSE, DISARM]
        assert "already" not in answers[1].text
        assert "already" not in answers[2].text
