"""A prior from other machines: made from their databases, read with the configuration, kept with the run."""

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gateway.acquisition.reload import ReloadError, bus_changes
from gateway.config.file import load
from gateway.control.restart.rebuild import controller_of
from gateway.storage.history import History
from tests.benches.machines_of_a_kind import CHANNELS, DAY, day, frames, store_run, talc_gateway, written
from tests.benches.restarted import replayed, restarted


@pytest.fixture(scope="module")
def shop(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the databases of three machines, and kind.json made from them."""
    folder = tmp_path_factory.mktemp("shop")
    for seed in (10, 11, 12):
        store_run(load(written(folder, f"mill{seed}")), frames(day(seed)))
    databases = [folder / f"mill{seed}.sqlite" for seed in (10, 11, 12)]
    answer = talc_gateway("prior", "make", *databases, "-o", folder / "kind.json")
    assert answer.exit_code == 0, answer.output
    assert "12 inputs; EY0A from 3, " in answer.output
    return folder


@pytest.fixture
def here(shop: Path, tmp_path: Path) -> Path:
    """A separate folder for a fourth machine, with the file."""
    (tmp_path / "kind.json").write_bytes((shop / "kind.json").read_bytes())
    return tmp_path


def test_a_replay_is_identical_whatever_became_of_the_file(here: Path) -> None:
    config = load(written(here, "mill", "kind.json"))
    store_run(config, frames(day(20))[:72])
    (here / "kind.json").write_text("{}", encoding="utf-8")
    changed = talc_gateway("replay", config.storage.path)
    (here / "kind.json").unlink()
    gone = talc_gateway("replay", config.storage.path)
    for answer in (changed, gone):
        assert answer.exit_code == 0, answer.output
        assert "72 steps, 0 trainings, 0 differences" in answer.output
    controller = controller_of(config.with_prior(None))
    with History(config.storage.path) as history:
        same = [np.array_equal(controller.step(s.frame).sigma, s.decision.sigma) for s in history.steps()]
    assert not all(same)


@pytest.mark.slow
def test_another_prior_after_a_restart_is_reported_and_replayed(here: Path) -> None:
    first = load(written(here, "mill"))
    found = frames(day(20))
    store_run(first, found[:100])
    second = load(written(here, "mill", "kind.json"))

    assert not restarted(first).other_prior
    assert restarted(second).other_prior
    store_run(second, found[100:200], restarted(second).controller)
    assert not restarted(second).other_prior
    assert restarted(first).other_prior, "there is none any more"
    store_run(first, found[200:], restarted(first).controller)
    result = replayed(first.storage.path)
    assert result.steps == DAY


@pytest.mark.slow
def test_the_prior_that_a_machine_began_with_is_not_counted_again(here: Path, shop: Path) -> None:
    told, alone = load(written(here, "told", "kind.json")), load(written(here, "alone"))
    for config in (told, alone):
        store_run(config, frames(day(20)))
        name = config.machine.name
        assert talc_gateway("prior", "make", here / f"{name}.sqlite", "-o", here / f"{name}.json").exit_code == 0
    assert (here / "told.json").read_bytes() == (here / "alone.json").read_bytes()


def test_check_counts_the_inputs_that_match(here: Path) -> None:
    channels = ("other", *CHANNELS[1:])
    answer = talc_gateway("check", written(here, "mill", "kind.json", channels))
    assert answer.exit_code == 0
    assert "prior of 3 machines, 9 thermal errors; it contains 11 of the 12 inputs here; 1 of its" in answer.output


def test_the_fingerprint_is_that_of_the_content(here: Path) -> None:
    path = written(here, "mill", "kind.json")
    before = load(path)
    text = (here / "kind.json").read_text(encoding="utf-8")
    (here / "kind.json").write_text(text.replace('"machines":3', '"machines":2'), encoding="utf-8")
    after = load(path)
    assert before.fingerprint() != after.fingerprint()
    with pytest.raises(ReloadError, match=r"the file of \[talc\] prior changed"):
        bus_changes(before, after)


def test_a_prior_with_the_papers_models_gets_a_warning(here: Path) -> None:
    path = written(here, "mill", "kind.json")
    path.write_text(path.read_text(encoding="utf-8").replace("[talc]", '[talc]\nmethod = "models"'), encoding="utf-8")
    answer = talc_gateway("check", path)
    assert answer.exit_code == 0
    assert "[talc] prior: has no effect with method = 'models'" in answer.output


def covariance(plain: dict[str, Any], value: object) -> None:
    plain["errors"]["EX0C"]["covariance"][0] = value


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda p: p.update(format=2), "format = 2: expected 1"),
        (
            lambda p: p.update(time_constants_s=[0, 60]),
            "time_constants_s = [0, 60]: expected those of this program, 0,",
        ),
        (lambda p: p.update(inputs="bed"), "inputs: expected a list of names"),
        (lambda p: p["inputs"].__setitem__(1, "t0"), "inputs: 't0' occurs twice"),
        (lambda p: p["span"].__setitem__(4, 0), "span[4] = 0: expected more than 0"),
        (lambda p: p["span"].pop(), "span: expected a list of 12 numbers, found 11"),
        (lambda p: p.update(errors={"EX1C": {}}), "errors.EX1C: expected a table under one of EY0A"),
        (lambda p: p["errors"]["EX0C"].update(machines=0), "errors.EX0C.machines = 0: expected a whole number, 1 to"),
        (lambda p: p["errors"]["EX0C"]["mean"].__setitem__(7, None), "errors.EX0C.mean[7] = None: expected a number"),
        (lambda p: covariance(p, float("nan")), "errors.EX0C.covariance[0] = nan: expected a number"),
        (lambda p: covariance(p, 1e300), "errors.EX0C.covariance[0] = 1e+300: expected a number, at most 1e+12"),
        (lambda p: covariance(p, -50.0), "errors.EX0C.covariance: has a variance of -50"),
        (
            lambda p: p.update(inputs=[f"u{i}" for i in range(12)]),
            "none of its inputs (u0, u1, u2, ...) has the name of an input here",
        ),
    ],
)
def test_what_is_wrong_with_a_file_is_reported(
    here: Path, change: Callable[[dict[str, Any]], object], said: str
) -> None:
    plain = json.loads((here / "kind.json").read_text(encoding="utf-8"))
    change(plain)
    (here / "kind.json").write_text(json.dumps(plain), encoding="utf-8")
    path = written(here, "mill", "kind.json")
    answer = talc_gateway("check", path)
    assert answer.exit_code == 2
    assert f"{path}: [talc] prior: '{here / 'kind.json'}': {said}" in answer.output
    assert "remove this line" in answer.output


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (None, "cannot be read: No such file or directory; make one with `talc-gateway prior make`"),
        (b"", "is not JSON: Expecting value"),
        (b"[" * 100_000, "is not JSON: "),
        (b"\xff", "can't decode byte 0xff"),
        (b"[1]", "is not a prior: expected a table"),
    ],
)
def test_a_file_that_is_not_a_prior_is_refused(tmp_path: Path, content: bytes | None, said: str) -> None:
    if content is not None:
        (tmp_path / "kind.json").write_bytes(content)
    answer = talc_gateway("check", written(tmp_path, "mill", "kind.json"))
    assert answer.exit_code == 2
    assert said in answer.output


def test_make_refuses_what_cannot_be_a_prior(shop: Path, tmp_path: Path) -> None:
    database = shop / "mill10.sqlite"
    again = talc_gateway("prior", "make", database, database, "-o", tmp_path / "a.json")
    over = talc_gateway("prior", "make", database, "-o", database)
    assert [again.exit_code, over.exit_code] == [2, 2]
    assert "is given twice" in again.output
    assert "would overwrite a database" in over.output
    store_run(load(written(tmp_path, "new")), frames(day(20))[:40])
    little = talc_gateway("prior", "make", tmp_path / "new.sqlite", "-o", tmp_path / "a.json")
    assert little.exit_code == 3
    assert (
        "no error was measured 12 times and found to be more than zero by most of 1 machines; let the" in little.output
    )
    assert not (tmp_path / "a.json").exists()


@pytest.mark.slow
def test_a_machine_that_counts_twice_is_warned_of(shop: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy.sqlite"
    copy.write_bytes((shop / "mill10.sqlite").read_bytes())
    answer = talc_gateway("prior", "make", shop / "mill10.sqlite", copy, "-o", tmp_path / "a.json")
    assert answer.exit_code == 0
    assert "[machine] name 'mill10' is also the name of" in answer.output


def test_a_recording_is_replayed_with_the_prior_of_the_config_s_folder(here: Path) -> None:
    days = day(20)
    with (here / "lathe.csv").open("w", newline="", encoding="utf-8") as file:
        out = csv.writer(file)
        out.writerow(["time", *days.names, "EX0C"])
        out.writerows([300 * k, *row, days.measured[k, 2] if k % 11 == 0 else ""] for k, row in enumerate(days.inputs))
    (here / "talc.toml").write_text('[talc]\nprior = "kind.json"\n', encoding="utf-8")
    answer = talc_gateway("replay", here / "lathe.csv", "--config", here / "talc.toml")
    assert answer.exit_code == 0, answer.output
    assert "prior of 3 machines, 9 thermal errors; it contains 12 of the 12 inputs" in answer.output
    assert "SHA-256" in (here / "lathe.html").read_text(encoding="utf-8")
