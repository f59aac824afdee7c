"""The study frame resumes where it was stopped; the small comparison is checked against a regression computed by
hand."""

import csv
import json
import os
import re
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

import talc
from studies import STUDIES, Run, carry_out, key, published_page
from studies.__main__ import main
from studies.arx_vs_static import REST, STEPS, judge_forecast, recordings
from studies.arx_vs_static_report import MODELS
from studies.frame import RunParameters, code_fingerprint
from studies.page import Report, Table
from tests.benches.small_study import study_by_command

pytestmark = pytest.mark.slow

STUDY = STUDIES["arx-vs-static"]
LIMIT_S = 300.0


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished small study, run by the command line with two processes."""
    studied = study_by_command(STUDY.name, tmp_path_factory.mktemp("study") / "made")
    assert len(studied.runs) == 8
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
    _, (_, truth, _) = recordings({"seed": 1, "pair": 1, "sensors": "far", "noise": False})
    drift = np.sqrt(np.mean(truth[REST:, 2] ** 2))
    assert rmse(folder, "none", "Z", sensors="far")[1] == pytest.approx(drift, rel=1e-12)
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


def test_report_labels_the_papers_figures_and_shows_the_losses(folder: Path) -> None:
    page = (folder / "report.html").read_text(encoding="utf-8")
    cells = '<th scope="row">paper: ARX</th>' + "".join(
        f"<td>{cell}</td>" for cell in (13, 1, 2, 4.3, 62.3, 3.5, 7.4, 41.9)
    )
    assert page.count(f'<tr class="paper">{cells}</tr>') == 4
    assert page.count("Where they lose") == 4
    assert page.count("<svg") == 1
    assert page.index("<figure") < page.index("<h2"), "it begins with the pictures"
    assert page.count("<table") == page.count("<caption>") > 1
    assert "<th>" not in page, "each says whose heading it is"


def test_the_table_on_the_page_is_renewed_between_its_marks(folder: Path, tmp_path: Path) -> None:
    page, command = tmp_path / "results.md", [STUDY.name, "--small", "--workers", "1", "--out", str(folder)]
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
    line = text.splitlines()[-3]
    assert line.startswith("`python -m studies arx-vs-static --seed 1 --small`, 8 runs, ")
    assert re.search(r", \d+\.\d min on 1 core, ", line)
    assert f", code {code_fingerprint(STUDY.run.__module__)[:8]}, " in line
    page.write_text("no marks\n", encoding="utf-8")
    answer = CliRunner().invoke(main, [*command, "--results", str(page)])
    assert answer.exit_code == 2
    assert "<!-- study arx-vs-static -->" in answer.output


def results(folder: Path) -> dict[str, Any]:
    """Results by file, without how long each run took, which varies."""
    kept = {file.name: json.loads(file.read_text(encoding="utf-8")) for file in (folder / "runs").iterdir()}
    return {name: (one["parameters"], one["result"]) for name, one in kept.items()}


@pytest.fixture
def copied(folder: Path, tmp_path: Path) -> Path:
    """The finished study, for a test that changes it."""
    return shutil.copytree(folder, tmp_path / "copied")


def undrawn(runs: list[Run]) -> Report:
    """A report without pictures, for tests that are not about them."""
    return Report("?", Table(("pair",), ()), (), (), [["pair"], *([r.parameters["pair"]] for r in runs)])


def test_a_stopped_study_goes_on_and_ends_the_same(copied: Path) -> None:
    before = results(copied)
    lost, cut = sorted(before)[:2]
    (copied / "runs" / lost).unlink()
    (copied / "runs" / cut).write_text(json.dumps({"result": 1})[:-2], encoding="utf-8")
    study = replace(STUDY, report=undrawn)
    assert list(carry_out(study, copied, 1, True, 1)) == [(6, 8), (7, 8), (8, 8)]
    assert results(copied) == before
    assert list(carry_out(study, copied, 1, True, 1)) == [(8, 8)]


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


def test_runs_without_their_time_make_no_time_and_the_goal_stands_beside_it(copied: Path) -> None:
    timed = {f: json.loads(f.read_text(encoding="utf-8")) for f in (copied / "runs").iterdir()}
    study = replace(STUDY, runs=lambda seed, _: STUDY.runs(seed, True), report=undrawn, goal_min=7.0)
    for seconds, line in (
        (30.0, ", 2.0 min on 2 cores (goal: 7 min on 2), "),
        (None, ", time not kept (goal: 7 min on 2), "),
    ):
        for file, content in timed.items():
            file.write_text(json.dumps({**content, "seconds": seconds}), encoding="utf-8")
        assert list(carry_out(study, copied, 1, False, 2)) == [(8, 8)]
        assert line in (copied / "summary.md").read_text(encoding="utf-8")


def test_runs_that_rest_on_the_first_ones_follow_them_and_are_kept_too(tmp_path: Path) -> None:
    def then(first: list[Run]) -> list[RunParameters]:
        return [{**run.parameters, "pair": 7} for run in first[:1]]

    study = replace(STUDY, runs=lambda seed, small: STUDY.runs(seed, small)[:1], report=undrawn, then=then)
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
    source = science / "added.py"
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


def test_unknown_study_is_named_and_the_list_is_shown() -> None:
    answer = CliRunner().invoke(main, ["arx"])
    assert answer.exit_code == 2
    assert "arx-vs-static" in answer.output
    assert "arx-vs-static" in CliRunner().invoke(main, []).output


def test_only_some_runs_are_done_and_the_page_says_so(tmp_path: Path) -> None:
    study = replace(STUDY, report=undrawn)
    only = {"sensors": ("near",), "noise": ("True",)}
    assert list(carry_out(study, tmp_path, 1, True, 1, only))[-1] == (2, 2)
    done = [json.loads(file.read_text(encoding="utf-8"))["parameters"] for file in (tmp_path / "runs").iterdir()]
    assert {(run["sensors"], run["noise"]) for run in done} == {("near", True)}
    again = "python -m studies arx-vs-static --seed 1 --small --only sensors=near --only noise=True"
    assert all(again in (tmp_path / name).read_text(encoding="utf-8") for name in ("summary.md", "report.html"))


@pytest.mark.parametrize(
    ("only", "said"),
    [("sensor=near", "sensor: no run has it"), ("sensors=here", "sensors=here: expected of near, far")],
)
def test_a_parameter_or_value_that_no_run_has_is_refused(only: str, said: str) -> None:
    answer = CliRunner().invoke(main, [STUDY.name, "--small", "--only", only])
    assert (answer.exit_code, said in answer.output) == (2, True)


def test_no_worker_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="workers = 0"):
        list(carry_out(STUDY, tmp_path, 1, True, 0))


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
