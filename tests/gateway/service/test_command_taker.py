"""Commands: what each does to the offsets and to probing, that each is stored, and its effect after a restart."""

from dataclasses import replace
from pathlib import Path

import pytest

from drivers.nc import OperatingMode, ProbingState, ProgramState, RequestStatus
from gateway.config.file import parse
from gateway.control.replay.stored import replay
from gateway.model.commands import UNPROVED, Command, CommandName, Pause
from gateway.model.compensation import Source
from gateway.model.events import CommandGiven
from gateway.storage.history import History
from gateway.storage.mending import Known, begin_again, mend
from gateway.storage.store import Store
from talc.frame import EventKind, Why
from tests.benches.commanded import CONFIG, NOWHERE, STEP_S, commanded
from tests.benches.nc_link_bench import LinkBench
from tests.benches.restarted import restarted
from tests.benches.stepped_clock import EPOCH

PAUSE, RESUME, MEASURE = CommandName.PAUSE, CommandName.RESUME, CommandName.MEASURE


async def test_a_pause_ramps_the_offsets_to_their_declared_state_until_it_is_resumed_and_nothing_steps() -> None:
    bench = LinkBench("compensate")
    async with commanded(bench, follow=6.0) as at:
        await bench.clock.run_until(20.0)
        assert bench.control.in_force == (0.0, 0.0, 6.0)
        paused = await at.give(PAUSE)
        assert paused.accepted
        assert bench.link.paused == Pause("anna", paused.time)
        await bench.clock.run_until(23.0)
        assert 2.0 <= bench.control.in_force[2] <= 4.0, "on its way at 1 µm/s"
        await bench.clock.run_until(200.0)
        assert bench.control.in_force == (0.0, 0.0, 0.0)
        assert bench.steps[-1].step.source is Source.PAUSED
        assert (await at.give(RESUME, "ben")).text == f"the compensation continues; it was {Pause('anna', paused.time)}"
        await bench.clock.run_until(220.0)
        assert bench.control.in_force == (0.0, 0.0, 6.0)
        assert at.largest_step_um() <= 1.0
    assert bench.control.beats[-1] > 218.0, "the heartbeat goes on in a pause"


async def test_with_when_stale_hold_a_pause_keeps_what_is_in_force() -> None:
    bench = LinkBench("compensate", when_stale="hold")
    async with commanded(bench, follow=6.0) as at:
        await bench.clock.run_until(20.0)
        await at.give(PAUSE)
        await bench.clock.run_until(60.0)
        assert bench.control.in_force == (0.0, 0.0, 6.0)


async def test_given_twice_a_command_changes_nothing_more() -> None:
    bench = LinkBench("compensate")
    async with commanded(bench, follow=6.0) as at:
        assert (await at.give(RESUME)).text == "the compensation was not paused"
        first = await at.give(PAUSE)
        bench.clock.spend(1.0)
        again = await at.give(PAUSE, "ben")
        assert again.accepted
        assert again.text == f"the compensation was {Pause('anna', first.time)} already"
        assert bench.link.paused == Pause("anna", first.time)


async def test_while_the_control_probes_a_pause_moves_nothing() -> None:
    bench = LinkBench("compensate")
    async with commanded(bench, follow=6.0) as at:
        await bench.clock.run_until(20.0)
        bench.control.probing = True
        await at.give(PAUSE)
        await bench.clock.run_until(100.0)
        assert bench.control.in_force == (0.0, 0.0, 6.0)
        bench.control.probing = False
        await bench.clock.run_until(120.0)
        assert bench.control.in_force == (0.0, 0.0, 0.0)
        assert at.largest_step_um() <= 1.0


async def test_paused_while_the_control_is_away_nothing_steps_when_it_comes_back() -> None:
    bench = LinkBench("compensate")
    async with commanded(bench, follow=6.0) as at:
        await bench.clock.run_until(20.0)
        bench.control.absent = True
        await bench.clock.run_until(30.0)
        assert (await at.give(PAUSE)).accepted
        bench.control.absent = False
        await bench.clock.run_until(120.0)
        assert bench.control.in_force == (0.0, 0.0, 0.0)
        assert at.largest_step_um() <= 1.0


async def test_a_command_never_arms_what_is_not_armed_or_has_disarmed_itself() -> None:
    unarmed = LinkBench("advise", armed=False)
    async with commanded(unarmed, follow=6.0) as at:
        measure = await at.give(MEASURE)
        assert (measure.accepted, measure.text) == (
            False, "probing is not armed; [probing] armed = true, and a restart, arm it"
        )  # fmt: skip
        await at.give(PAUSE)
        assert "compensation is not armed" in (await at.give(RESUME)).text
        await unarmed.clock.run_until(400.0)
    assert (unarmed.control.writes, unarmed.control.beats, unarmed.control.requests) == ([], [], [])

    bench = LinkBench("compensate")
    async with commanded(bench, follow=6.0) as at:
        await bench.clock.run_until(20.0)
        bench.control.in_force = (0.0, 0.0, 3.0)  # somebody else's
        await bench.clock.run_until(25.0)
        assert not bench.link.armed
        await at.give(PAUSE)
        await at.give(RESUME)
        many = len(bench.control.writes)
        await bench.clock.run_until(100.0)
        assert (bench.link.armed, len(bench.control.writes)) == (False, many)


async def test_a_measurement_is_requested_in_this_grid_step_although_the_program_runs() -> None:
    bench = LinkBench("monitor")
    bench.control.answer = RequestStatus(0, ProbingState.DONE, NOWHERE)
    bench.control.program, bench.control.speed = ProgramState.RUNNING, 8000.0
    async with commanded(bench) as at:
        await bench.clock.run_until(10.0)
        assert at.told.outlooks == [], "the controller has not decided yet"
        answer = await at.give(MEASURE)
        assert (answer.accepted, answer.text) == (True, "a measurement is requested before this grid step ends")
        await bench.clock.run_until(STEP_S + 1.0)
        assert [o.why for o in at.told.outcomes] == [Why.COMMAND]
        assert at.told.frames[0].measurement is not None
        assert bench.control.requests == [41, 42, 43, 44, 45], "the reference, at 120 s"


async def test_what_blocks_a_measurement_is_answered_and_a_command_is_dropped_after_a_while() -> None:
    bench = LinkBench("monitor")
    bench.control.mode = OperatingMode.JOG
    async with commanded(bench) as at:
        await bench.clock.run_until(10.0)
        answer = await at.give(MEASURE)
        assert answer.text == (
            "a measurement is requested as soon as nothing blocks it; now: the control is in JOG, not in AUTO"
        )
        await bench.clock.run_until(1900.0)
        [dropped] = [text for text in at.told.texts(EventKind.OPERATOR) if "commanded" in text]
        assert dropped == (
            "the measurement that was commanded was not possible for 30 min: the control is in JOG, not in AUTO"
        )
        assert bench.control.requests == []


async def test_while_a_measurement_runs_a_second_one_is_not_asked_for() -> None:
    bench = LinkBench("monitor")
    async with commanded(bench) as at:
        await bench.clock.run_until(10.0)
        await at.give(MEASURE)
        await bench.clock.run_until(130.0)
        assert bench.control.requests == [41]
        assert (await at.give(MEASURE)).text == "a measurement is under way already"
        bench.control.answer = RequestStatus(0, ProbingState.FAILED, reason="a touch found no sphere")
        await bench.clock.run_until(290.0)
        assert bench.control.requests == [41], "one command, one request"


async def test_each_command_is_an_event_and_a_row_with_who_when_and_what_became_of_it(tmp_path: Path) -> None:
    bench, path = LinkBench("compensate"), tmp_path / "a.sqlite"
    async with commanded(bench, follow=0.0) as at:
        with Store(path, "boot", bench.clock) as store:
            await at.give(PAUSE)
            await at.give(
                MEASURE, "ben", "ben may not give this command: it is not in `may` of their [[telemetry.operator]]"
            )
            for event in at.told.all:
                store.record(event)
    given = [event.outcome for event in at.told.of(CommandGiven)]
    with History(path) as history:
        assert history.commands() == given
    assert [(o.command, o.time, o.accepted) for o in given] == [
        (Command(PAUSE, "anna"), EPOCH, True), (Command(MEASURE, "ben"), EPOCH, False),
    ]  # fmt: skip
    assert at.told.texts(EventKind.COMMAND)[1] == (
        "ben: measure refused: ben may not give this command: it is not in `may` of their [[telemetry.operator]]"
    )


async def test_without_a_disk_a_pause_counts_at_once_and_nothing_else_does() -> None:
    bench = LinkBench("compensate")
    async with commanded(bench, follow=6.0) as at:
        await bench.clock.run_until(20.0)
        at.disk_fails = "database or disk is full"
        paused = await at.give(PAUSE)
        assert paused.accepted
        assert paused.text.endswith("; not stored yet, and a restart would forget it: database or disk is full")
        for name in (RESUME, MEASURE):
            answer = await at.give(name)
            assert not answer.accepted
            assert answer.text.startswith("it cannot be stored: database or disk is full")
        await bench.clock.run_until(60.0)
        assert bench.control.in_force == (0.0, 0.0, 0.0)
        assert at.told.outcomes == []


async def test_of_too_many_commands_ten_an_hour_are_stored_and_a_pause_always_counts() -> None:
    bench = LinkBench("compensate")
    async with commanded(bench, follow=6.0) as at:
        for _ in range(20):
            assert (await at.give(RESUME)).accepted
        assert (await at.give(RESUME)).text == "too many commands; wait a minute"
        assert (await at.give(PAUSE)).accepted
        for _ in range(30):
            assert not (await at.give(RESUME, "ben")).accepted
            assert (await at.give(PAUSE, "ben")).accepted, "it stands already, and is not stored again"
        stored = [event.outcome for event in at.told.of(CommandGiven)]
        assert [o.accepted for o in stored] == [True] * 20 + [False, True] + [False] * 9
        assert {(o.command.by, o.text) for o in stored[22:]} == {("ben", "too many commands; wait a minute")}
        bench.clock.spend(61.0)
        assert (await at.give(RESUME)).accepted
        bench.clock.spend(3600.0)
        for _ in range(21):
            await at.give(RESUME)
        assert at.told.of(CommandGiven)[-1].outcome.text == (
            "too many commands; wait a minute (21 more were refused before, and are not stored)"
        )


async def test_what_nobody_proved_is_stored_changes_nothing_and_uses_up_nobody_s_commands(tmp_path: Path) -> None:
    bench, path = LinkBench("compensate"), tmp_path / "a.sqlite"
    async with commanded(bench, follow=0.0) as at:
        with Store(path, "boot", bench.clock) as store:
            for name in CommandName:
                for _ in range(10):
                    assert not (await at.give(name, UNPROVED, "by and key are not those of an operator")).accepted
            assert not (await at.give(PAUSE, UNPROVED)).accepted, "whatever the door says"
            assert (bench.link.paused, bench.link.disarmed) == (None, None)
            assert (await at.give(RESUME)).accepted
            for event in at.told.all:
                store.record(event)
    with History(path) as history:
        stored = history.commands()
    assert stored[0].command == Command(MEASURE, UNPROVED)
    assert stored[0].text == "by and key are not those of an operator"
    assert [o.command.by for o in stored if o.accepted] == ["anna"]


async def test_a_pause_survives_restarts_and_the_loss_of_the_database_until_it_is_resumed(tmp_path: Path) -> None:
    config = parse(CONFIG, tmp_path / "gateway.toml")
    path, bench = config.storage.path, LinkBench("compensate")

    async with commanded(bench, follow=6.0) as at:
        with Store(path, "first", bench.clock) as store:
            store.begin(config.canonical(), config.fingerprint(), "")
            answer = await at.give(PAUSE)
            store.record(CommandGiven(answer))
            row = (answer.time.isoformat(), "pause", "anna", 1, answer.text)
            store.record(CommandGiven(replace(answer, command=Command(RESUME, "ben"), accepted=False)))
            store.record(CommandGiven(replace(answer, command=Command(MEASURE, "ben"))))
            store.record(CommandGiven(replace(answer, command=Command(PAUSE, "ben"))))
    pause = Pause("anna", answer.time)
    assert restarted(config).paused == pause
    again = LinkBench("compensate", in_force=(0.0, 0.0, 4.0), paused=restarted(config).paused)
    async with commanded(again, follow=6.0) as at:
        await again.clock.run_until(60.0)
        assert again.control.in_force == (0.0, 0.0, 0.0), "from what is in force to the declared state"
        assert again.link.paused == pause
        assert at.largest_step_um(begins=4.0) <= 1.0
        for known in (
            Known(standing={PAUSE: row}),
            Known(),
        ):  # the running gateway has it in memory, or reads what is there
            mend(path, "a bit has flipped", EPOCH, known)
            assert restarted(config).paused == pause
        path.unlink()
        begin_again(path, Known(standing={PAUSE: row}))
        assert restarted(config).paused == pause
        with Store(path, "second", again.clock) as store:
            store.record(CommandGiven(await at.give(RESUME, "ben")))
    assert restarted(config).paused is None


@pytest.mark.slow
async def test_a_run_with_commands_is_replayed_bit_for_bit(tmp_path: Path) -> None:
    config = parse(CONFIG, tmp_path / "gateway.toml")
    bench = LinkBench("compensate")
    bench.control.answer = RequestStatus(0, ProbingState.DONE, NOWHERE)
    async with commanded(bench) as at:
        for k in range(6):
            await bench.clock.run_until(k * STEP_S + 10.0)
            await at.give((MEASURE, PAUSE, MEASURE, RESUME, CommandName.DISARM, CommandName.ARM)[k])
        await bench.clock.run_until(8 * STEP_S + 1.0)
    with Store(config.storage.path, "boot", bench.clock) as store:
        store.begin(config.canonical(), config.fingerprint(), "")
        for event in at.told.all:
            store.record(event)
    assert Why.COMMAND in {outcome.why for outcome in at.told.outcomes}
    with History(config.storage.path) as history:
        result = replay(history)
        assert len(history.commands()) == 6
    assert (result.identical, result.steps) == (True, 8), result.first
