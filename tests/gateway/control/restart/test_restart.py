"""A restart from a snapshot decides as one from the whole record; other settings and inputs keep what was learnt."""

import asyncio
import sqlite3
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from itertools import count
from pathlib import Path

import numpy as np
import pytest

from gateway.config.file import parse
from gateway.config.model import GatewayConfig
from gateway.control.replay.stored import replay
from gateway.control.restart.earlier import EarlierRun, earlier_run, past_of
from gateway.control.restart.rebuild import Interrupted, Rebuilt, marks
from gateway.control.restart.snapshots import SnapshotKeeper
from gateway.model.events import DecisionMade, FrameMade, ModelsAdopted
from gateway.service.serving import serve
from gateway.storage.backup import back_up
from gateway.storage.history import History
from gateway.storage.snapshot import SnapshotError, decode_snapshot
from gateway.storage.store import Store
from gateway.storage.stored import StoredStep
from talc.control import Controller
from talc.frame import Decision, Frame, Measurement
from talc.papers.training import train
from tests.benches.restarted import replayed, restarted
from tests.benches.service_file import MACHINE, adam6015, short_calibration
from tests.benches.stepped_clock import SteppedClock

TEXT = MACHINE + '[storage]\npath = "gateway.sqlite"\n' + adam6015("bed = 0, column = 1, ram = 2")
EVERY = 60
GAP = 20
LONGER = 2 * EVERY + GAP + 15


def config_of(folder: Path, method: str = "learner", **more: str) -> GatewayConfig:
    text = TEXT + short_calibration(method)
    for old, new in more.items():
        text = text.replace(old, new)
    return parse(text, folder / "gateway.toml")


def frames(first: int, end: int) -> Iterable[Frame]:
    """A warm machine with a sensor that is absent at times, a gap, and a measurement each twelve steps."""
    for k in range(first, end):
        if 50 <= k < 50 + GAP:
            continue
        draw = np.random.default_rng(k)
        x = 20.0 + np.array([np.sin(k / 40.0), np.sin(k / 70.0), k / 400.0]) + draw.normal(0, 0.02, 3)
        valid = np.array([True, k % 100 > 10, True])
        errors = 4.0 * (x[0] - 20.0) + np.arange(9.0) + draw.normal(0, 0.3, 9)
        measured = Measurement(errors, np.full(9, 0.3)) if k < 46 or k % 12 == 0 else None
        yield Frame(k, x, valid, measured)


def run(config: GatewayConfig, past: EarlierRun, first: int, end: int, boot: str) -> list[Decision]:
    """Run as the service does: every step is stored, a training ends within its step, and a keeper takes the
    snapshots."""
    made = []
    with Store(config.storage.path, boot, SteppedClock()) as store:
        store.begin(config.canonical(), config.fingerprint(), "")
        keeper = SnapshotKeeper(past, store, config, EVERY)
        for frame in frames(first, end):
            made.append(decision := past.controller.step(frame))
            keep(frame, decision, past, store, keeper)
    return made


def keep(frame: Frame, decision: Decision, past: EarlierRun, store: Store, keeper: SnapshotKeeper) -> None:
    """Store a step; a training that it asks for ends within it."""
    for event in (FrameMade(frame), DecisionMade(decision)):
        store.record(event)
        keeper.take(event)
    if frame.k % (EVERY // 2) == 0:
        store.flush()  # on a busy computer the next snapshot would take the place of one that still waits
    if decision.training is not None:
        models = train(decision.training)
        past.controller.adopt(models)
        store.record(ModelsAdopted(models, decision.k))


def fresh(config: GatewayConfig) -> EarlierRun:
    return EarlierRun(Controller(config.input_names, config.talc))


def snapshots(path: Path) -> list[int]:
    with closing(sqlite3.connect(path)) as connection:
        return [k for (k,) in connection.execute("SELECT k FROM snapshot ORDER BY k")]


def change(path: Path, statement: str, *given: object) -> None:
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute(statement, given)


def assert_same(one: Iterable[Decision], other: Iterable[Decision]) -> None:
    for a, b in zip(one, other, strict=True):
        for name in ("predicted", "corrected", "sigma", "limits", "trusted"):
            assert getattr(a, name).tobytes() == getattr(b, name).tobytes(), (a.k, name)
        assert (a.k, a.phase, a.measure, a.events, a.substituted) == (b.k, b.phase, b.measure, b.events, b.substituted)
        assert (a.training is None) == (b.training is None)


def assert_same_past(one: EarlierRun, other: EarlierRun) -> None:
    assert (one.last_k, one.pending, one.missing, one.measured) == (
        other.last_k, other.pending, other.missing, other.measured,
    )  # fmt: skip
    assert_same([one.controller.step(f) for f in frames(LONGER, LONGER + 20)],
                [other.controller.step(f) for f in frames(LONGER, LONGER + 20)])  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("method", ["learner", pytest.param("models", marks=pytest.mark.slow)])
def test_a_restart_from_a_snapshot_decides_as_one_from_the_whole_record(method: str, tmp_path: Path) -> None:
    config = config_of(tmp_path, method)
    run(config, fresh(config), 0, LONGER, "earlier")
    assert len(snapshots(config.storage.path)) == 2
    quick = restarted(config)
    assert quick.since_snapshot < EVERY
    change(config.storage.path, "DELETE FROM snapshot")
    whole = restarted(config)
    assert whole.since_snapshot == LONGER - GAP
    assert_same_past(quick, whole)
    replayed(config.storage.path)


@pytest.mark.slow
def test_a_replay_is_identical_over_restarts_from_snapshots_each_of_which_repeats_little(tmp_path: Path) -> None:
    config = config_of(tmp_path)
    past = fresh(config)
    for number in range(4):  # none lasts for as long as a snapshot takes
        run(config, past, number * 50, number * 50 + 50, f"boot{number}")
        past = restarted(config)
        assert past.since_snapshot < EVERY
    assert len(snapshots(config.storage.path)) == 2
    with History(config.storage.path) as history:
        result = replay(history)
    assert (result.identical, result.steps) == (True, 180), result.first


@pytest.mark.slow
@pytest.mark.parametrize("method", ["learner", "models"])
def test_another_computer_goes_on_from_a_backup_with_what_was_learnt(method: str, tmp_path: Path) -> None:
    config, new = config_of(tmp_path / "failed", method), config_of(tmp_path / "new", method)
    for computer in (config, new):
        computer.storage.path.parent.mkdir()
    run(config, fresh(config), 0, LONGER, "earlier")
    back_up(config.storage.path, new.storage.path, readings=False)
    assert_same_past(restarted(new), restarted(config))
    run(new, restarted(new), LONGER, LONGER + 20, "later")
    replayed(new.storage.path)


@pytest.mark.slow
@pytest.mark.parametrize("spoilt", ["SELECT max(k) FROM snapshot", "SELECT k FROM snapshot"])
def test_a_damaged_snapshot_is_replaced_by_the_one_before_or_by_the_record(spoilt: str, tmp_path: Path) -> None:
    config = config_of(tmp_path)
    run(config, fresh(config), 0, LONGER, "earlier")
    whole = restarted(config)
    at = "length(state) / 2"
    other = f"CASE substr(state, {at} + 1, 1) WHEN x'00' THEN x'01' ELSE x'00' END"
    broken = f"CAST(substr(state, 1, {at}) || {other} || substr(state, {at} + 2) AS BLOB)"
    change(config.storage.path, f"UPDATE snapshot SET state = {broken} WHERE k IN ({spoilt})")
    again = restarted(config)
    assert again.since_snapshot > whole.since_snapshot
    assert_same_past(again, whole)


def test_other_settings_or_inputs_make_a_snapshot_of_no_use(tmp_path: Path) -> None:
    ours = marks(config_of(tmp_path))
    others = [
        config_of(tmp_path, "models"),
        config_of(tmp_path, **{"[talc.control]": "[talc.learner]\nlimit_um = 7.0\n[talc.control]"}),
        config_of(tmp_path, **{"ram = 2": "slide = 2"}),
    ]
    assert ours not in map(marks, others)
    assert len(set(map(marks, others))) == 3
    unused = config_of(tmp_path, **{"calibration_steps = 36": "calibration_steps = 48"})
    assert marks(unused) == ours, "the learner has no calibration"


def test_a_snapshot_is_ahead_of_no_step_that_is_stored(tmp_path: Path) -> None:
    config = config_of(tmp_path)
    run(config, fresh(config), 0, LONGER, "earlier")
    ahead = max(snapshots(config.storage.path))
    change(config.storage.path, "DELETE FROM frame WHERE k >= ?", ahead)
    change(config.storage.path, "DELETE FROM decision WHERE k >= ?", ahead)
    assert restarted(config).last_k == ahead - 1


def test_bytes_that_are_no_snapshot_are_refused() -> None:
    for data in (b"", b"x" * 40, bytes(1000)):
        with pytest.raises(SnapshotError, match="checksum"):
            decode_snapshot(data, lambda *_: pytest.fail("not reached"))


def test_a_rebuild_can_be_interrupted(tmp_path: Path) -> None:
    config = config_of(tmp_path)
    run(config, fresh(config), 0, 100, "earlier")
    steps = 0

    def progress(_: Rebuilt) -> None:
        nonlocal steps
        steps += 1
        if steps > 10:
            raise Interrupted

    with History(config.storage.path) as history, pytest.raises(Interrupted):
        past_of(history, config, progress)
    assert steps == 11


def other_inputs(folder: Path, method: str) -> GatewayConfig:
    """The ram's sensor was removed, one on the slide and one at the bed's far end are new, and the order is
    different."""
    return config_of(folder, method, **{"bed = 0": "slide = 2", "ram = 2": "bed = 0, end = 3"})


def reordered(config: GatewayConfig, frame: Frame) -> Frame:
    """The frame as the new configuration has it; the new sensors have values from now on."""
    bed, column, _ = frame.inputs
    named = {"bed": bed, "column": column, "slide": 21.0 + bed / 7.0, "end": 20.0 + column / 9.0}
    x = np.array([named[name] for name in config.input_names])
    return Frame(frame.k, x, np.ones(4, np.bool_), frame.measurement)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["learner", pytest.param("models", marks=pytest.mark.slow)])
def test_other_inputs_and_settings_keep_what_was_learnt_and_are_replayed(method: str, tmp_path: Path) -> None:
    before = config_of(tmp_path, method)
    run(before, fresh(before), 0, LONGER, "earlier")
    config = other_inputs(tmp_path, method)
    past = restarted(config)
    assert past.last_k == LONGER - 1
    assert past.changes == ("new: end, slide", "gone: ram")
    told = [past.controller.step(reordered(config, frame)) for frame in frames(LONGER, LONGER + 5)]
    if method == "learner":
        errors = [4.0 * np.sin(d.k / 40.0) + np.arange(9.0) for d in told]
        off = np.abs(np.array([d.corrected for d in told]) - errors)
        assert off.mean() < 1.0, "it knew from the bed what to expect; without, it is 4 and more off"
        assert np.isfinite(off).all()
    past = restarted(config)
    with Store(config.storage.path, "later", SteppedClock()) as store:
        store.begin(config.canonical(), config.fingerprint(), "")
        keeper = SnapshotKeeper(past, store, config, EVERY)
        for frame in frames(LONGER, LONGER + 2 * EVERY):
            other = reordered(config, frame)
            keep(other, past.controller.step(other), past, store, keeper)
    with History(config.storage.path) as history:
        result = replay(history)
        seen = past_of(history, config).seen
    assert result.identical, result.first
    assert seen is not None
    assert seen.frames.inputs.shape == (LONGER - GAP + 2 * EVERY, 4)
    assert not seen.frames.valid[: LONGER - GAP, config.input_names.index("slide")].any()


@pytest.mark.slow
def test_other_settings_learn_from_the_whole_record_again(tmp_path: Path) -> None:
    before = config_of(tmp_path)
    run(before, fresh(before), 0, LONGER, "earlier")
    config = config_of(tmp_path, **{"[talc.control]": "[talc.learner]\nlimit_um = 7.0\n[talc.control]"})
    past = restarted(config)
    assert past.changes == ("limit_um 5.0 -> 7.0",)
    assert past.since_snapshot == LONGER - GAP
    (next_frame,) = frames(LONGER, LONGER + 1)
    decision = past.controller.step(next_frame)
    assert decision.limits[0] == 7.0
    assert decision.trusted.any()


@pytest.mark.slow
def test_a_rebuild_that_was_interrupted_continues_where_it_was(tmp_path: Path) -> None:
    config = config_of(tmp_path)
    run(config, fresh(config), 0, LONGER, "earlier")
    change(config.storage.path, "DELETE FROM snapshot")
    whole = restarted(config)

    def progress(found: Rebuilt) -> None:
        if found.last_k == LONGER - 10:
            raise Interrupted

    with Store(config.storage.path, "later", SteppedClock()) as store, pytest.raises(Interrupted):
        earlier_run(store, config, progress, save_every=25)
    again = restarted(config)
    assert again.since_snapshot < 25 + 10
    assert_same_past(again, whole)


async def test_a_gateway_that_repeats_an_endless_record_stops_when_it_is_told_to(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = config_of(tmp_path, **{"[talc]": "[telemetry]\nenabled = false\n[talc]"})
    run(config, fresh(config), 0, 30, "earlier")
    stop, loop = asyncio.Event(), asyncio.get_running_loop()
    whole = History.steps

    def endless(history: History, after_k: int = -1, names: Sequence[str] | None = None) -> Iterator[StoredStep]:
        steps = list(whole(history, after_k, names))
        for lap in count():
            for step in steps:
                if lap == 1:
                    loop.call_soon_threadsafe(stop.set)
                yield replace(step, frame=replace(step.frame, k=step.frame.k + 30 * lap))

    monkeypatch.setattr(History, "steps", endless)
    async with asyncio.timeout(60):
        await serve(config, SteppedClock(), stop, simulated=True)
    monkeypatch.undo()
    assert restarted(config).last_k == 29, "nothing was added"
