"""The study frame resumes where it was stopped; the small comparison is checked against a regression computed by
hand."""

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

import simulators
import talc
from studies import STUDIES, Run, carry_out, key, published_page
from studies.__main__ import main
from studies.arx_vs_static import REST, STEPS, judge_forecast, recordings
from studies.arx_vs_static_report import MODELS
from studies.frame import RunParameters, code_fingerprint
from tests.benches.quick_study import STUDY as QUICK
from tests.benches.small_study import study_by_command

pytestmark = pytest.mark.slow

STUDY = replace(
    STUDIES["arx-vs-static"],
    runs=lambda seed, small: [
        run for run in STUDIES["arx-vs-static"].runs(seed, small) if run["pair"] == 0 and run["sensors"] == "near"
    ],
)
"""With one pair of load cases and the sensors near the sources."""
LIMIT_S = 300.0


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished small study, run by the command line."""
    studied = study_by_command(STUDY.name, tmp_path_factory.mktemp("study") / "made", "pair=0", "sensors=near")
    assert len(studied.runs) == 2
    return studied.folder


def figures(folder: Path) -> list[dict[str, str]]:
    with (folder / "figures.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def rmse(folder: Path, model: str, direction: str, sensors: str = "near", noise: str = "0") -> list[float]:
    wanted = {"model": model, "direction": direction, "sensors": sensors, "noise": noise}
    return [float(row["RMSE_um"]) for row in figures(folder) if wanted.items() <= row.items()]


def test_static_is_the_regression_of_the_first_record_judged_on_the_second(folder: Path) -> None:
    (u, _, y), (new_u, truth, _) = recordings({"seed": 1, "pair": 0, "sensors": "near", "noise": True})
    own = np.column_stack([np.ones(STEPS), u])
    fit = np.linalg.lstsq(own[4:], y[4:, 1], rcond=None)[0]  # the longest model in Y has four rows of past
    left = truth[REST:, 1] - np.column_stack([np.ones(STEPS), new_u])[REST:] @ fit
    assert rmse(folder, "static", "Y", noise="1")[0] == pytest.approx(np.sqrt(np.mean(left**2)), rel=1e-6)


def test_none_is_the_drift_itself(folder: Path) -> None:
    _, (_, truth, _) = recordings({"seed": 1, "pair": 0, "sensors": "near", "noise": False})
    drift = np.sqrt(np.mean(truth[REST:, 2] ** 2))
    assert rmse(folder, "none", "Z")[0] == pytest.approx(drift, rel=1e-12)
    assert judge_forecast(truth[:, 2], np.zeros(STEPS))["PV"] == pytest.approx(100.0)


def test_near_and_noise_change_the_reading_and_not_the_days() -> None:
    plain = recordings({"seed": 1, "pair": 0, "sensors": "near", "noise": False})
    spoilt = recordings({"seed": 1, "pair": 0, "sensors": "far", "noise": True})
    other = recordings({"seed": 1, "pair": 1, "sensors": "near", "noise": False})
    assert np.array_equal(plain[1][1], spoilt[1][1])
    assert not np.array_equal(plain[0][1], plain[1][1])
    assert not np.array_equal(plain[0][1], other[0][1])
    steps = spoilt[0][0] / 0.1
    assert np.allclose(steps, np.round(steps), atol=1e-6)


def test_with_clean_sensors_near_the_sources_a_pole_helps(folder: Path) -> None:
    for direction in ("Y", "Z"):
        assert max(rmse(folder, "ARX", direction)) < min(rmse(folder, "static", direction))


def test_the_table_on_the_page_is_renewed_between_its_marks(folder: Path, tmp_path: Path) -> None:
    page, command = (
        tmp_path / "results.md",
        [STUDY.name, "--small", "--only", "pair=0", "--only", "sensors=near", "--workers", "1", "--out", str(folder)],
    )
    page.write_text("before\n<!-- study arx-vs-static -->\nstale table\n<!-- end -->\nafter\n", encoding="utf-8")
    answer = CliRunner().invoke(
        main, [*command, "--results", str(page), "--pages", str(tmp_path / "pages")], catch_exceptions=False
    )
    assert answer.exit_code == 0, answer.output
    drawn_again = published_page(tmp_path / "pages" / STUDY.name)
    assert drawn_again.split() == (folder / "report.html").read_text(encoding="utf-8").split()
    text = page.read_text(encoding="utf-8")
    assert text.startswith("before\n<!-- study arx-vs-static -->\n| RMSE, µm, median |")
    assert text.endswith("<!-- end -->\nafter\n")
    assert "stale table" not in text
    assert code_fingerprint(STUDY.run.__module__)[:8] in text.splitlines()[-3]
    page.write_text("no marks\n", encoding="utf-8")
    answer = CliRunner().invoke(main, [*command, "--results", str(page)])
    assert answer.exit_code == 2
    assert "<!-- study arx-vs-static -->" in answer.output


def results(folder: Path) -> dict[str, Any]:
    """Results by file, without how long each run took, which varies."""
    kept = {file.name: json.loads(file.read_text(encoding="utf-8")) for file in (folder / "runs").iterdir()}
    return {name: (one["parameters"], one["result"]) for name, one in kept.items()}


@pytest.fixture
def quick(tmp_path: Path) -> Path:
    """A finished study of quick runs."""
    folder = tmp_path / "quick"
    assert list(carry_out(QUICK, folder, 1, True, 2))[-1] == (8, 8)
    return folder


def test_a_stopped_study_goes_on_and_ends_the_same(quick: Path) -> None:
    before = results(quick)
    lost, cut = sorted(before)[:2]
    (quick / "runs" / lost).unlink()
    (quick / "runs" / cut).write_text(json.dumps({"result": 1})[:-2], encoding="utf-8")
    assert list(carry_out(QUICK, quick, 1, True, 1)) == [(6, 8), (7, 8), (8, 8)]
    assert results(quick) == before
    assert list(carry_out(QUICK, quick, 1, True, 1)) == [(8, 8)]


def test_a_model_that_ran_away_is_not_counted_as_beaten() -> None:
    def made_up(sensors: str, noise: bool, ours: float, plain: float) -> Run:
        left = dict.fromkeys(MODELS, 10.0) | {"output error": ours, "ARX": plain}
        figures = {model: {"PV": v, "RMSE": v, "P99": v, "SMAPE": v} for model, v in left.items()}
        return Run({"seed": 1, "pair": 0, "sensors": sensors, "noise": noise}, {"Y": figures, "Z": figures})

    lost, won, ran_away = (1.2, 0.2), (1.0, 2.0), (1.0, 5e6)
    runs = [made_up(s, n, *lost) for s, n in (("near", False), ("near", True))]
    runs += [made_up("far", False, *ran_away), made_up("far", True, *won)]
    claim = STUDY.report(runs).claims[-1]
    assert not claim.holds  # 2 of 6; with the two that ran away it would be 4 of 8
    assert "in 2 of 6 medians, and where ARX ran away (Y, far, clean, Z, far, clean)" in claim.here
    assert "at worst 6.0 times ARX's (Y, near, clean: 1.2 against 0.2 µm)" in claim.here
    assert STUDY.report([*runs[2:], *runs[2:]]).claims[-1].holds


def test_runs_without_their_time_make_no_time(quick: Path) -> None:
    timed = {f: json.loads(f.read_text(encoding="utf-8")) for f in (quick / "runs").iterdir()}
    study = replace(QUICK, runs=lambda seed, _: QUICK.runs(seed, True))
    for seconds, line in ((30.0, ", 2.0 min on 2 cores, "), (None, ", time not kept, ")):
        for file, content in timed.items():
            file.write_text(json.dumps({**content, "seconds": seconds}), encoding="utf-8")
        assert list(carry_out(study, quick, 1, False, 2)) == [(8, 8)]
        assert line in (quick / "summary.md").read_text(encoding="utf-8")


def test_runs_that_rest_on_the_first_ones_follow_them_and_are_kept_too(tmp_path: Path) -> None:
    def then(first: list[Run]) -> list[RunParameters]:
        return [{**run.parameters, "pair": 7} for run in first[:1]]

    study = replace(QUICK, runs=lambda seed, small: QUICK.runs(seed, small)[:1], then=then)
    assert list(carry_out(study, tmp_path, 1, True, 1)) == [(0, 1), (1, 1), (1, 2), (2, 2)]
    assert list(carry_out(study, tmp_path, 1, True, 1)) == [(1, 1), (2, 2)]
    assert {row["pair"] for row in figures(tmp_path)} == {"0", "7"}


@pytest.fixture
def science(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A copy of talc's sources, of which fingerprints are made instead."""
    copy = tmp_path / "talc"
    shutil.copytree(Path(talc.__file__).parent, copy, ignore=shutil.ignore_patterns("__pycache__", "*.so"))
    with monkeypatch.context() as patch:
        patch.setattr(talc, "__file__", str(copy / "__init__.py"))
        yield copy
    code_fingerprint.cache_clear()


def test_another_learner_leaves_the_runs_of_models_as_they_are(science: Path) -> None:
    study = STUDIES["adaptive-inputs"]
    ways = {way["selector"]: way for way in study.runs(1, True)}

    def keys() -> dict[str, str]:
        code_fingerprint.cache_clear()
        return {name: key(study, way) for name, way in ways.items()}

    before = keys()
    for source, line in (
        ("learner/experts.py", "MORE = 1\n"),
        ("kernel/learner.hpp", "\n"),
        ("settings.py", "MORE = 1\n"),
    ):
        with (science / source).open("a", encoding="utf-8") as file:
            file.write(line)
        after = keys()
        assert after["learner"] != before["learner"]
        assert (after["pso"] != before["pso"]) == (source == "settings.py")
        before = after


@pytest.mark.parametrize(
    ("old", "new", "other"),
    [
        ("# seconds", "# s, of the grid", False),
        ('"""Of a model."""', '"""Of one model.\n\nLonger.\n"""', False),
        ('"""Its step."""', "", False),
        ('    """Its gain."""\n', '    """Its gain,\n    without a unit."""\n', False),
        ("300.0", "301.0", True),
        ("STEP_S", "STEP", True),
        ('"gain"', '"gains"', True),
        ("2 * gain", "gain * 2", True),
    ],
)
def test_a_fingerprint_is_of_the_code_and_not_of_its_prose(science: Path, old: str, new: str, other: bool) -> None:
    source = science / "stage.py"
    text = (
        '"""Of a model."""\n\nSTEP_S = 300.0  # seconds\n"""Its step."""\n\n\ndef gained(gain):\n    """Its gain."""\n'
    )
    text += '    return {"gain": 2 * gain}\n'

    def fingerprint(code: str) -> str:
        source.write_text(code, encoding="utf-8")
        code_fingerprint.cache_clear()
        return code_fingerprint(STUDY.run.__module__)

    changed = text.replace(old, new)
    assert changed != text
    assert (fingerprint(changed) != fingerprint(text)) == other


@pytest.mark.parametrize(
    ("source", "other"),
    [
        ("talc/indicators.py", True),
        ("talc/kernel/lag.hpp", True),
        ("talc/papers/__init__.py", True),
        ("simulators/plant/machine.toml", True),
        ("simulators/plant/reduced/stiff.json", True),
        ("talc/estimators/trained.py", False),
        ("talc/kinematics.py", False),
        ("simulators/three_body/reduced.json", False),
    ],
)
def test_a_fingerprint_is_of_what_the_study_imports(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, source: str, other: bool
) -> None:
    for package in (talc, simulators):
        own = Path(str(package.__file__)).parent
        copy = tmp_path / own.name
        shutil.copytree(own, copy, ignore=shutil.ignore_patterns("__pycache__", "*.so"))
        monkeypatch.setattr(package, "__file__", str(copy / "__init__.py"))

    def fingerprint() -> str:
        code_fingerprint.cache_clear()
        return code_fingerprint(STUDIES["adaptive-inputs"].run.__module__)

    before = fingerprint()
    file = tmp_path / source
    file.write_text(
        file.read_text(encoding="utf-8") + ("MORE = 1\n" if file.suffix == ".py" else "\n"), encoding="utf-8"
    )
    after = fingerprint()
    monkeypatch.undo()
    code_fingerprint.cache_clear()
    assert (after != before) == other


def test_unknown_study_is_named_and_the_list_is_shown() -> None:
    answer = CliRunner().invoke(main, ["arx"])
    assert answer.exit_code == 2
    assert "arx-vs-static" in answer.output
    assert "arx-vs-static" in CliRunner().invoke(main, []).output


@pytest.mark.parametrize(
    ("only", "said"),
    [("sensor=near", "sensor: no run has it"), ("sensors=here", "sensors=here: expected of near, far")],
)
def test_a_parameter_or_value_that_no_run_has_is_refused(only: str, said: str) -> None:
    answer = CliRunner().invoke(main, [STUDY.name, "--small", "--only", only])
    assert (answer.exit_code, said in answer.output) == (2, True)


def test_no_worker_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="workers = 0"):
        list(carry_out(QUICK, tmp_path, 1, True, 0))


def test_a_terminated_study_leaves_no_worker_behind(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "studies", "parameters", "--workers", "2", "--out", str(tmp_path)]
    study = subprocess.Popen(command, start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        wait_until(lambda: len(_group(study.pid)) >= 4)  # the study, its two workers, and who cleans up after them
        study.terminate()
        study.wait(LIMIT_S)
        wait_until(lambda: not _group(study.pid))
    finally:
        with suppress(ProcessLookupError):
            os.killpg(study.pid, signal.SIGKILL)


def wait_until(true: Callable[[], bool]) -> None:
    deadline = time.monotonic() + LIMIT_S
    while not true():
        assert time.monotonic() < deadline, f"{LIMIT_S:g} s have passed"
        time.sleep(0.1)


def _group(number: int) -> list[str]:
    """Living processes of a process group, by their entries in /proc."""
    found = []
    for entry in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            state, _, group = entry.read_text().rpartition(")")[2].split()[:3]
            if int(group) == number and state != "Z":
                found.append(entry.parent.name)
    return found
