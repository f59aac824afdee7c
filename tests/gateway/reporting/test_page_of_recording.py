"""The page of a recording says how it was made and what was not checked; replay says how long a calibration takes."""

import hashlib
import html
import re
import shlex
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import pytest

from gateway.control.replay.recorded import rehearse_recording
from gateway.reporting.page import build
from gateway.reporting.recordings.columns import Columns
from gateway.reporting.recordings.grid import read_recording
from talc.settings import TalcSettings
from tests.benches.command import here


def recording(folder: Path, spacing_s: float, rows: int) -> Path:
    path = folder / "some mill.csv"
    lines = (f"{spacing_s * i:g},{20 + i % 7 * 0.3:.1f},{i},{i % 5}" for i in range(rows))
    path.write_text("\n".join(["time,t1,note,EX0C", *lines]), encoding="utf-8")
    return path


def page_of(path: Path) -> str:
    return html.unescape(path.with_suffix(".html").read_text(encoding="utf-8"))


def test_the_page_can_be_made_again_from_what_it_says(tmp_path: Path) -> None:
    path, config = recording(tmp_path, 300.0, 60), tmp_path / "talc.toml"
    config.write_text("[talc.control]\ncalibration_steps = 24\n", encoding="utf-8")
    assert here("replay", path, "--config", config, "--ignore", "note", "--every-measurement").code == 0
    page = page_of(path)
    said = re.search(r"<code>(talc-gateway replay .*?)</code>", page)
    assert said is not None
    command = shlex.split(said[1])
    path.with_suffix(".html").unlink()
    assert here("replay", *command[2:]).code == 0
    assert page_of(path) == page
    for file in (path, config):
        assert f"{file.name}, " in page
        assert hashlib.sha256(file.read_bytes()).hexdigest() in page
    assert "calibration_steps = 24, calibration_interval_steps = 1" in page
    assert 'selector = "search"' in page
    for name in ("scipy", "osqp", "numpy"):
        assert f"{name} {version(name)}" in page


def test_the_command_holds_what_was_given(tmp_path: Path) -> None:
    path, page = recording(tmp_path, 300.0, 60), tmp_path / "page.html"
    told = ["-o", str(page), "--time", "time", "--error", "EZ0T=note", "--error", "EX0C=EX0C"]
    assert here("replay", path, *told).code == 0
    text = html.unescape(page.read_text(encoding="utf-8"))
    assert f"talc-gateway replay '{path}' -o {page} --error EZ0T=note --error EX0C=EX0C</code>" in text
    assert "EZ0T = note, EX0C</code>" in text


def test_the_page_claims_no_check_that_was_not_made(tmp_path: Path) -> None:
    path = recording(tmp_path, 300.0, 60)
    here("replay", path)
    page = page_of(path)
    assert "Not looked for: a recording does not say which of its inputs are temperatures" in page
    assert "No offset and no exchange" not in page
    assert "cycles rejected" not in page


@pytest.mark.parametrize(
    ("spacing_s", "rows", "said"),
    [
        (
            420.0,
            400,
            "288 steps of 420 s, 33.6 h, measured at every step, as rows 420 s apart are a step each: calib",
        ),
        (
            3600.0,
            71,
            "288 steps of 3600 s, 288.0 h, measured at every step, longer than the recording, 71.0 h: there will be no",
        ),
        (
            300.0,
            60,
            "288 steps of 300 s, 24.0 h, measured at every step, longer than the recording, 5.0 h: there will be no",
        ),
        (300.0, 300, None),
    ],
)
def test_a_calibration_longer_than_a_day_is_reported(
    tmp_path: Path, spacing_s: float, rows: int, said: str | None
) -> None:
    path, config = recording(tmp_path, spacing_s, rows), tmp_path / "talc.toml"
    config.write_text('[talc]\nmethod = "models"\n', encoding="utf-8")
    answer = here("replay", path, "--config", config)
    assert answer.code == 0
    if said is None:
        assert "Calibration takes" not in answer.together
        assert "288 steps of 300 s, 24.0 h, measured at every step" in page_of(path)
    else:
        assert f"Calibration takes {said}" in answer.together


@pytest.mark.slow
def test_the_page_of_a_gateway_says_whether_sensors_were_compared(tmp_path: Path) -> None:
    recorded = rehearse_recording(
        read_recording(recording(tmp_path, 300.0, 60), Columns(), 300.0), TalcSettings(method="models")
    )
    run_of_gateway = replace(recorded, recorded=None, held=None, compared=True)
    assert "No offset and no exchange of temperature sensors was found" in build(run_of_gateway)
    off = build(replace(run_of_gateway, compared=False))
    assert "Not looked for: [sensor_check] enabled = false." in off
    assert "No offset and no exchange" not in off
