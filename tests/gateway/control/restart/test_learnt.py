"""What was learnt leaves one database as JSON and continues in another one, as far as names match."""

import json
import math
import zlib
from base64 import b64decode, b64encode
from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gateway.config.file import load
from gateway.config.model import GatewayConfig
from gateway.control.replay.stored import replay
from gateway.control.restart.earlier import EarlierRun
from gateway.model.events import DecisionMade, FrameMade, MeasurementEnded, ModelsAdopted
from gateway.model.probing import Outcome
from gateway.runtime.ages import Ages
from gateway.storage.history import History
from gateway.storage.learnt import learnt_text, parse_learnt
from gateway.storage.store import Store
from talc.control import Controller
from talc.frame import Decision, Frame, Measurement, Why
from talc.papers.training import train
from talc.settings import TalcSettings
from talc.transfer import transferred
from tests.benches.command import here
from tests.benches.fuzzed_files import signed
from tests.benches.restarted import restarted
from tests.benches.service_file import MACHINE, adam6015, short_calibration
from tests.benches.stepped_clock import EPOCH, SteppedClock

NAMES = ("bed", "column", "ram")
STEPS = 60
CENTRES = np.arange(18.0).reshape(6, 3)


def config_of(folder: Path, names: Sequence[str] = NAMES, method: str = "learner") -> GatewayConfig:
    folder.mkdir(exist_ok=True)
    channels = ", ".join(f"{name} = {i}" for i, name in enumerate(names))
    text = MACHINE + adam6015(channels) + short_calibration(method)
    (folder / "gateway.toml").write_text(text, encoding="utf-8")
    return load(folder / "gateway.toml")


def frame(k: int, names: Sequence[str] = NAMES, *, measured: bool = True) -> Frame:
    draw = np.random.default_rng(k)
    all_of_them = 20.0 + np.array([np.sin(k / 40.0), np.sin(k / 70.0), k / 400.0]) + draw.normal(0, 0.02, 3)
    x = np.array([all_of_them[NAMES.index(name)] if name in NAMES else 7.0 for name in names])
    errors = 4.0 * (all_of_them[0] - 20.0) + np.arange(9.0) + draw.normal(0, 0.3, 9)
    measurement = Measurement(errors, np.full(9, 0.3)) if measured and (k < 40 or k % 12 == 0) else None
    return Frame(k, x, np.ones(len(names), np.bool_), measurement)


def shortened(packed: dict[str, Any], kept: int) -> dict[str, Any]:
    """An array of the file, reduced to the first numbers of its last axis."""
    array = np.frombuffer(zlib.decompress(b64decode(packed["zlib"])), packed["kind"]).reshape(packed["shape"])
    less = np.ascontiguousarray(array[..., :kept])
    return {**packed, "shape": list(less.shape), "zlib": b64encode(zlib.compress(less.tobytes())).decode()}


def go_on(config: GatewayConfig, past: EarlierRun, boot: str, first: int, end: int) -> list[Decision]:
    made = []
    with Store(config.storage.path, boot, SteppedClock()) as store:
        store.begin(config.canonical(), config.fingerprint(), "")
        for k in range(first, end):
            one = replace(frame(k, config.input_names), pause_unknown=k == first and boot == "after")
            if one.measurement is not None:
                done = Outcome(k + 1, Why.INTERVAL, EPOCH, EPOCH, CENTRES + k, (1.0, 2.0, 3.0), one.measurement, 0.4)
                store.record(MeasurementEnded(done))
            decision = past.controller.step(one)
            store.record(FrameMade(one))
            store.record(DecisionMade(decision))
            if decision.training is not None:
                models = train(decision.training)
                past.controller.adopt(models)
                store.record(ModelsAdopted(models, k))
            made.append(decision)
    return made


@pytest.fixture(scope="module", params=["learner", "models"])
def source(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> GatewayConfig:
    config = config_of(tmp_path_factory.mktemp("source"), method=request.param)
    go_on(config, EarlierRun(Controller(config.input_names, config.talc)), "before", 0, STEPS)
    answer = here("db", "export-learnt", config.storage.path, "-o", file_of(config))
    assert answer.code == 0, answer.together
    return config


def file_of(config: GatewayConfig) -> Path:
    return config.storage.path.with_name("learnt.json")


def test_a_controller_goes_on_in_another_database_and_predicts_the_same(source: GatewayConfig, tmp_path: Path) -> None:
    target = config_of(tmp_path / "here", method=source.talc.method)
    answer = here("db", "import-learnt", tmp_path / "here" / "gateway.toml", file_of(source))
    assert answer.code == 0, answer.together
    assert "taken from mill: 3 inputs" in answer.together
    assert "reference of 2026-03-02 06:00 UTC" in answer.together
    there, past = restarted(source), restarted(target)
    for k in range(STEPS, STEPS + 5):
        one = frame(k)
        was, now = there.controller.step(one), past.controller.step(one)
        for name in ("predicted", "corrected", "sigma", "limits", "trusted"):
            assert getattr(was, name).tobytes() == getattr(now, name).tobytes(), (k, name)
        assert now.phase == was.phase
    assert there.reference_mm is not None
    np.testing.assert_array_equal(past.reference_mm, there.reference_mm)


def test_how_old_it_is_is_unknown_and_a_restart_and_a_replay_go_on_from_it(
    source: GatewayConfig, tmp_path: Path
) -> None:
    target = config_of(tmp_path / "here", method=source.talc.method)
    assert here("db", "import-learnt", tmp_path / "here" / "gateway.toml", file_of(source)).code == 0
    past = restarted(target)
    assert math.isinf(Ages(SteppedClock(), 300.0, past.moment, past.pauses).pause_s)
    made = go_on(target, past, "after", 1000, 1030)
    assert made[0].measure is not None, "it is measured at once"
    again = restarted(target)
    assert again.last_k == 1029
    one = frame(1030, measured=False)
    assert again.controller.step(one).predicted.tobytes() == past.controller.step(one).predicted.tobytes()
    with History(target.storage.path) as history:
        result = replay(history)
        first = history.reference()
    assert result.identical, result.first
    assert first is not None
    np.testing.assert_array_equal(first.centres_mm, CENTRES)


def test_inputs_are_matched_by_name_and_what_is_not_taken_is_said(source: GatewayConfig, tmp_path: Path) -> None:
    target = config_of(tmp_path / "here", ("spindle", "column", "bed"), source.talc.method)
    answer = here("db", "import-learnt", tmp_path / "here" / "gateway.toml", file_of(source))
    assert answer.code == 0, answer.together
    assert "inputs not here, left out: ram" in answer.together
    assert "inputs new here, nothing is known of them: spindle" in answer.together
    decisions = go_on(target, restarted(target), "after", STEPS, STEPS + 40)
    assert np.isfinite(decisions[-1].corrected).all()


def test_a_database_with_a_record_is_only_replaced_when_told_and_kept(source: GatewayConfig, tmp_path: Path) -> None:
    target = config_of(tmp_path / "here", method=source.talc.method)
    file = tmp_path / "here" / "gateway.toml"
    go_on(target, EarlierRun(Controller(target.input_names, target.talc)), "own", 0, 5)
    refused = here("db", "import-learnt", file, file_of(source))
    assert (refused.code, restarted(target).last_k) == (3, 4)
    assert "has a record, which the import would replace" in refused.together
    taken = here("db", "import-learnt", file, file_of(source), "--replace")
    assert taken.code == 0, taken.together
    (kept,) = target.storage.path.parent.glob("gateway.sqlite.before-import-*")
    with History(kept) as history:
        assert history.latest_k() == 4
    assert restarted(target).last_k is None
    assert here("db", "import-learnt", file, file_of(source)).code == 0, "again, as there is no record yet"
    with Store(target.storage.path, "running", SteppedClock()):
        assert here("db", "import-learnt", file, file_of(source)).code == 3


def test_what_does_not_fit_is_refused(source: GatewayConfig, tmp_path: Path) -> None:
    other = {"learner": "models", "models": "learner"}[source.talc.method]
    for name, names, method, said in (
        ("method", NAMES, other, f"method = '{source.talc.method}'"),
        ("names", ("x", "y"), source.talc.method, "none of them has the name of an input here"),
    ):
        config_of(tmp_path / name, names, method)
        answer = here("db", "import-learnt", tmp_path / name / "gateway.toml", file_of(source))
        assert answer.code == 3
        assert said in answer.together
        assert not (tmp_path / name / "gateway.sqlite").exists()


def test_a_damaged_or_foreign_file_is_refused_by_field(source: GatewayConfig) -> None:
    text = file_of(source).read_text(encoding="utf-8")
    for spoilt, said in (
        (text[:-200], "is not JSON"),
        ("[]", "format = \\[\\]: expected"),
        (json.dumps({"format": 1, "inputs": []}), "format = 1: expected 'talc-gateway learnt'"),
        (text.replace('"version": 1', '"version": 2'), "version = 2: expected 1"),
        (text.replace('"machine": "mill"', '"machine": "mall"'), "sha256 = '[0-9a-f]+.*: does not match the rest"),
    ):
        with pytest.raises(ValueError, match=said):
            parse_learnt(spoilt)
    for field, value, said in (
        ("inputs", ["bed", "bed", "ram"], "inputs = "),
        ("step_s", -300.0, "step_s = -300.0"),
        ("method", 7, "method = 7"),
        ("controller", {"format": 99}, "controller: "),
        ("controller", {"format": []}, "controller: "),
        ("controller", None, "controller: "),
        ("arrays", {"held": {"kind": "O", "shape": [9], "zlib": ""}}, "arrays.held: its kind"),
        ("arrays", {"held": {"kind": "<f8", "shape": [2**40], "zlib": ""}}, "arrays.held: its shape"),
        ("arrays", {}, "arrays.held: is missing"),
        ("reference", {"ended": "yesterday"}, "reference: "),
    ):
        with pytest.raises(ValueError, match=said):
            parse_learnt(signed(json.loads(text) | {field: value}))


def test_what_an_earlier_learner_knew_and_an_array_of_another_shape_are_refused(source: GatewayConfig) -> None:
    if source.talc.method == "models":
        return
    whole = json.loads(file_of(source).read_text(encoding="utf-8"))
    with pytest.raises(ValueError, match="format = 3"):
        parse_learnt(signed(whole | {"controller": whole["controller"] | {"format": 3}}))
    whole["arrays"]["mixture.x"] = whole["arrays"]["mixture.relevance"]
    with pytest.raises(ValueError, match=r"arrays\.mixture\.x"):
        parse_learnt(signed(whole))


def test_the_file_is_the_same_after_a_round_trip(source: GatewayConfig) -> None:
    text = file_of(source).read_text(encoding="utf-8")
    assert learnt_text(parse_learnt(text)) == text
    assert datetime.fromisoformat(json.loads(text)["reference"]["ended"]) == EPOCH


def test_another_order_of_the_inputs_changes_no_estimate() -> None:
    settings = TalcSettings()
    one = Controller(NAMES, settings)
    for k in range(STEPS):
        one.step(frame(k))
    turned = ("ram", "bed", "column")
    other = Controller.restore(transferred(one.state(), Controller(turned, settings).state()), settings)
    for k in range(STEPS, STEPS + 30):
        was, now = one.step(frame(k)), other.step(frame(k, turned))
        np.testing.assert_allclose(now.corrected, was.corrected, rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(now.sigma, was.sigma, rtol=1e-6)


def test_what_an_input_that_is_left_out_has_explained_is_not_laid_on_the_others() -> None:
    settings = TalcSettings()
    one = Controller(NAMES, settings)
    for k in range(STEPS):
        one.step(frame(k))
    before = one.weights()
    target = ("ram", "bed", "spindle")
    other = Controller.restore(transferred(one.state(), Controller(target, settings).state()), settings)
    after = other.weights()
    assert before is not None
    assert after is not None
    np.testing.assert_allclose(after.inputs[:, :2], before.inputs[:, [2, 0]], atol=0.1 * np.abs(before.inputs).max())
    assert np.abs(after.inputs[:, 2]).max() < 1e-9
    assert (after.inputs_sigma[:, 2, 0] > 0.0).all()


def test_what_other_experts_learnt_is_refused_with_their_number() -> None:
    settings = TalcSettings()
    one = Controller(NAMES, settings)
    one.step(frame(0))
    known = one.state()
    assert known.course is not None
    mixture = known.course.learner.mixture
    fewer = replace(mixture, evidence=mixture.evidence[:, 1:])
    learner = replace(known.course.learner, mixture=fewer)
    other = replace(known, strategy=replace(known.course, learner=learner))
    there = fewer.evidence.shape[1]
    with pytest.raises(ValueError, match=rf"\b{there}\b.*\b{there + 1}\b"):
        transferred(other, Controller(NAMES, settings).state())
