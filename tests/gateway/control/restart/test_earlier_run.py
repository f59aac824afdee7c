"""What a restart resumes from the store: frames, the age of suspicions, and a training that had failed."""

import json
import math
import sqlite3
from contextlib import closing
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest

from gateway.config.file import parse
from gateway.config.model import GatewayConfig
from gateway.control.restart.earlier import earlier_run, past_of
from gateway.control.sensor_watch import SeenBefore
from gateway.control.trainer import models_of_failure
from gateway.model.events import DecisionMade, EventReported, FrameMade, ModelsAdopted
from gateway.runtime.workers.process import WorkError
from gateway.storage.faults import StoreError
from gateway.storage.history import History
from gateway.storage.store import Store
from talc.control import Controller
from talc.frame import Event, EventKind, Frame, Measurement
from tests.benches.restarted import replayed, restarted
from tests.benches.service_file import MACHINE, adam6015
from tests.benches.stepped_clock import SteppedClock

TEXT = f"""{MACHINE}
[storage]
path = "gateway.sqlite"
[talc]
method = "models"
[talc.control]
calibration_steps = 36
""" + adam6015("bed = 0, column = 1")
STEPS = 60
SUSPECT = Event(EventKind.SENSOR_SUSPECT, "bed is off by +2.0 K against the other sensors", value=2.0)
AGREE = Event(EventKind.SENSORS_AGREE, "the sensors agree with each other again")


@pytest.fixture
def config(tmp_path: Path) -> GatewayConfig:
    return parse(TEXT, tmp_path / "gateway.toml")


def stored_run(config: GatewayConfig, *events: tuple[int, Event], adopted: bool = True) -> None:
    """Sixty frames, a training wanted meanwhile that failed (or never ended), and what the sensor check reported."""
    draw = np.random.default_rng(8)
    x = 20.0 + np.cumsum(draw.normal(0, 0.2, (STEPS, 2)), axis=0)
    controller = Controller(config.input_names, config.talc)
    with Store(config.storage.path, "earlier", SteppedClock()) as store:
        store.begin(config.canonical(), config.fingerprint(), "")
        for k in range(STEPS):
            frame = Frame(k, x[k], np.ones(2, np.bool_), Measurement(x[k, 0] + draw.normal(0, 0.1, 9), np.full(9, 0.1)))
            decision = controller.step(frame)
            store.record(FrameMade(frame))
            store.record(DecisionMade(decision))
            if decision.training is not None and adopted:
                models = models_of_failure(
                    decision.training, WorkError("its process was ended by SIGKILL; out of memory?")
                )
                for event in controller.adopt(models):
                    store.record(EventReported(event, k))
                store.record(ModelsAdopted(models, k))
        for k, event in events:
            store.record(EventReported(event, k))


def seen(config: GatewayConfig) -> SeenBefore:
    found = restarted(config).seen
    assert found is not None
    return found


def test_the_sensor_watch_goes_on_from_the_stored_frames(config: GatewayConfig) -> None:
    stored_run(config)
    before = seen(config)
    assert (before.frames.k.tolist(), before.suspect_since_k) == (list(range(STEPS)), None)
    assert before.frames.inputs.shape == (STEPS, 2)
    assert before.frames.valid.all()


@pytest.mark.slow
def test_planned_loads_go_on_from_the_stored_frames_of_two_weeks(tmp_path: Path) -> None:
    of_models = TEXT[TEXT.index("[talc]") : TEXT.index("[[bus]]")]
    few = TEXT.replace(of_models, "[sensor_check]\nwindow_steps = 12\nlearn_steps = 36\n")
    config = parse(few, tmp_path / "gateway.toml")
    stored_run(config)
    assert len(seen(config).frames.k) == 48, "all that the sensor check looks at"
    planned = parse(few + '[[planned_load]]\nname = "warm"\nloads = { bed = 25.0 }\n', tmp_path / "gateway.toml")
    assert len(seen(planned).frames.k) == STEPS


def test_what_was_suspect_and_had_not_ended_still_is(config: GatewayConfig) -> None:
    stored_run(config, (10, SUSPECT), (20, AGREE), (30, SUSPECT), (40, SUSPECT))
    assert seen(config).suspect_since_k == 30


def test_a_replay_does_not_repeat_a_training_that_the_computer_made_fail(config: GatewayConfig) -> None:
    stored_run(config)
    result = replayed(config.storage.path)
    assert (result.steps, result.trainings) == (STEPS, 0)


def test_a_training_that_never_ended_is_taken_up_and_one_that_failed_is_not(config: GatewayConfig) -> None:
    stored_run(config, adopted=False)
    job = restarted(config).pending[0]
    assert job is not None
    assert job.k == 35
    config.storage.path.unlink()
    stored_run(config)
    assert restarted(config).pending[0] is None


def test_a_restart_remembers_when_each_error_was_measured(config: GatewayConfig) -> None:
    controller = Controller(config.input_names, config.talc)
    errors = {2: [1.0] * 9, 5: [math.nan] * 4 + [2.0] * 4 + [math.nan]}
    with Store(config.storage.path, "earlier", SteppedClock()) as store:
        store.begin(config.canonical(), config.fingerprint(), "")
        for k in range(8):
            measurement = Measurement(np.array(errors[k]), np.full(9, 0.1)) if k in errors else None
            frame = Frame(k, np.full(2, 20.0), np.ones(2, np.bool_), measurement)
            store.record(FrameMade(frame))
            store.record(DecisionMade(controller.step(frame)))
    assert restarted(config).measured == (2, 2, 2, 2, 5, 5, 5, 5, 2)


def stored_before_methods(config: GatewayConfig) -> None:
    """Rewrite the stored configurations as programs without `[talc] method` wrote them: no such key, other order."""
    text = json.loads(config.canonical())
    text["talc"] = {name: text["talc"][name] for name in ("training", "control")}
    old = json.dumps(dict(reversed(text.items())))
    with closing(sqlite3.connect(config.storage.path)) as connection, connection:
        connection.execute("UPDATE boot SET config = ?, fingerprint = 'old'", (old,))
        connection.execute("DROP TABLE running")


def with_method(config: GatewayConfig, method: str) -> GatewayConfig:
    return parse(TEXT.replace('method = "models"', f'method = "{method}"'), config.storage.path)


def test_a_database_without_a_method_is_replayed_and_continued_with_models(config: GatewayConfig) -> None:
    config = with_method(config, "models")
    stored_run(config)
    stored_before_methods(config)
    replayed(config.storage.path)
    past = restarted(config)
    assert (past.former_method, past.last_k) == (None, STEPS - 1)


def test_a_restart_with_another_method_learns_from_the_record_and_is_replayed(config: GatewayConfig) -> None:
    former, config = with_method(config, "models"), with_method(config, "learner")
    stored_run(former)
    stored_before_methods(former)
    past = restarted(config)
    assert past.former_method == "models"
    with Store(config.storage.path, "later", SteppedClock()) as store:
        store.begin(config.canonical(), config.fingerprint(), "")
        for k in range(STEPS, STEPS + 5):
            frame = Frame(k, np.array([20.0, 21.0]), np.ones(2, np.bool_), None)
            decision = past.controller.step(frame)
            assert np.isfinite(decision.predicted).all(), "it learnt from the earlier measurements"
            store.record(FrameMade(frame))
            store.record(DecisionMade(decision))
    result = replayed(config.storage.path)
    assert result.steps == STEPS + 5


def test_settings_that_the_method_does_not_use_change_nothing(config: GatewayConfig) -> None:
    stored_run(config)
    text = config.canonical()
    learner = json.loads(text) | {"talc": json.loads(text)["talc"] | {"learner": {"limit_um": 7.0}}}
    with History(config.storage.path) as history:
        past = past_of(history, GatewayConfig.model_validate(learner))
    assert (past.last_k, past.changes) == (STEPS - 1, ())


def test_another_grid_step_needs_another_database(config: GatewayConfig) -> None:
    stored_run(config)
    other = GatewayConfig.model_validate(json.loads(config.canonical()) | {"grid": {"step_s": 60.0}})
    with History(config.storage.path) as history, pytest.raises(StoreError, match="step_s = 300, not 60"):
        past_of(history, other)


def test_a_configuration_that_only_an_earlier_program_accepts_is_no_damage(config: GatewayConfig) -> None:
    stored_run(config)
    text = config.canonical().replace('"step_s":', '"gone":1,"step_s":')
    assert text != config.canonical()
    with closing(sqlite3.connect(config.storage.path)) as database, database:
        database.execute("UPDATE boot SET config = ?, fingerprint = ?", (text, sha256(text.encode()).hexdigest()))
    said = r"does not accept the configuration of the latest run: .*gone"
    with Store(config.storage.path, "this", SteppedClock()) as store, pytest.raises(StoreError, match=said):
        earlier_run(store, config)
    assert list(config.storage.path.parent.glob("*damaged*")) == []
    with History(config.storage.path) as history:
        assert len(list(history.steps(-1))) == STEPS
