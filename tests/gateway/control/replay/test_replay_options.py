"""What `replay` takes besides a plain table: other names, units and times; and the table that it writes."""

import csv
import re
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

import numpy as np
import pyarrow.parquet
import pytest

from gateway.control.replay.recorded import learnt_columns, rehearse_recording
from gateway.reporting.data import AdoptedModels
from gateway.reporting.recordings.columns import Columns
from gateway.reporting.recordings.grid import read_recording
from gateway.reporting.recordings.problems import RecordingError
from gateway.reporting.recordings.times import TimeFormat
from talc.models import ModelSet
from talc.names import THERMAL_ERRORS
from talc.settings import TalcSettings
from tests.benches.command import here
from tests.benches.control_models import INPUTS, model

START = datetime(2026, 3, 2, 6, tzinfo=UTC)


def table(folder: Path, head: str, rows: int = 40, times: list[str] | None = None) -> Path:
    """Two temperatures that swing, and after them columns that follow the first."""
    path, lines = folder / "own.csv", [head]
    for i in range(rows):
        t1, t2 = 20.0 + 5.0 * np.sin(i / 6), 20.0 + 3.0 * np.cos(i / 9)
        errors = [f"{(3 + j) * (t1 - 20.0):.6f}" for j in range(head.count(",") - 2)]
        time = times[i] if times else str(int(START.timestamp()) + 300 * i)
        lines.append(",".join([time, f"{t1:.4f}", f"{t2:.4f}", *errors]))
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def test_errors_may_have_any_names_and_keep_them(tmp_path: Path) -> None:
    path = table(tmp_path, "time,t1,t2,lift,tilt")
    answer = here("replay", path, "--error", "spindle lift=lift", "--error", "tilt=tilt", "--unit", "tilt=arcsec")
    assert answer.code == 0, answer.together
    assert "errors: spindle lift = lift, tilt in arcsec\ninputs (2): t1, t2\n" in answer.together
    page = path.with_suffix(".html").read_text("utf-8")
    assert "spindle lift" in page
    assert "EY0A" not in page
    assert "--unit tilt=arcsec" in page


def test_units_are_converted(tmp_path: Path) -> None:
    path = table(tmp_path, "time,t1,t2,EX0C,EA0C")
    plain = read_recording(path, Columns(), 300.0).errors
    found = read_recording(path, Columns(units={"EX0C": "mm", "EA0C": "mrad"}), 300.0).errors
    np.testing.assert_allclose(found[:, [2, 6]], 1000.0 * plain[:, [2, 6]])
    with pytest.raises(RecordingError, match=r"unit of EX0C: 'rad' is no unit of µm; expected nm, um, mm, m, in$"):
        read_recording(path, Columns(units={"EX0C": "rad"}), 300.0)
    with pytest.raises(RecordingError, match="unit of EY0A: there is no such error"):
        read_recording(path, Columns(units={"EY0A": "mm"}), 300.0)
    answer = here("replay", path, "--unit", "EX0C=furlong")
    assert answer.code == 2
    assert "EX0C=furlong: expected one of nm, um, mm" in answer.together


def test_more_errors_than_the_controller_has_places_for_are_refused(tmp_path: Path) -> None:
    names = [f"{letter}lift" for letter in "pqrstuv"]
    path = table(tmp_path, ",".join(["time", "t1", "t2", *names]))
    with pytest.raises(RecordingError, match="error vlift: has no place: the controller takes six errors in µm"):
        read_recording(path, Columns(errors={name: name for name in names}), 300.0)


@pytest.mark.parametrize(
    ("error", "other"), [("drift1", "drift2"), ("dev_x", "dev_y"), ("Z drift", "thermal error Y"), ("z", "x")]
)
def test_the_neighbour_of_an_error_is_not_silently_an_input(tmp_path: Path, error: str, other: str) -> None:
    path = table(tmp_path, f"time,t1,t2,{error},{other}")
    given = {"EZ0T": error}
    with pytest.raises(RecordingError, match=f"column '{other}': resembles '{error}', which is an error"):
        read_recording(path, Columns(errors=given), 300.0)
    assert read_recording(path, Columns(errors=given, inputs=(other,)), 300.0).input_names == ("t1", "t2", other)
    assert read_recording(path, Columns(errors=given, ignored=(other,)), 300.0).input_names == ("t1", "t2")
    answer = here("replay", path, "--error", f"EZ0T={error}", "--input", other, "--ignore", other)
    assert f"column '{other}': has two roles" in answer.together


def test_an_error_that_is_hardly_in_micrometres_is_reported(tmp_path: Path) -> None:
    path = table(tmp_path, "time,t1,t2,EX0C")
    heading, *lines = path.read_text(encoding="utf-8").splitlines()
    cells = [line.rsplit(",", 1) for line in lines]
    path.write_text("\n".join([heading, *(f"{a},{float(b) / 1000:.6f}" for a, b in cells)]), encoding="utf-8")
    assert "--unit EX0C=mm" in here("replay", path).together
    assert "--unit EX0C=mm" not in here("replay", path, "--unit", "EX0C=mm").together


@pytest.mark.parametrize(
    "head",
    ["time,t1,t2,growth,Drift X", "time,t1,t2,EX0C,Z deviation", "time,t1,t2,EX0C,Spindelverlagerung Z [µm]"],
)
def test_what_is_called_an_error_is_not_silently_an_input(tmp_path: Path, head: str) -> None:
    path, other = table(tmp_path, head), head.split(",")[-1]
    given = {"Z": "growth"} if "growth" in head else None
    with pytest.raises(
        RecordingError, match=f"column '{re.escape(other)}': is an error by its name; as an input it may"
    ):
        read_recording(path, Columns(errors=given), 300.0)
    assert other in read_recording(path, Columns(errors=given, inputs=(other,)), 300.0).input_names


def test_what_was_measured_with_an_error_is_not_silently_an_input(tmp_path: Path) -> None:
    path = table(tmp_path, "time,t1,t2,growth,bending")
    heading, *lines = path.read_text(encoding="utf-8").splitlines()
    rows = [line if i % 6 == 0 else ",".join([*line.split(",")[:3], "", ""]) for i, line in enumerate(lines)]
    path.write_text("\n".join([heading, *rows]), encoding="utf-8")
    given = {"Z": "growth"}
    with pytest.raises(RecordingError, match="column 'bending': has values only where 'growth' has them, which is an"):
        read_recording(path, Columns(errors=given), 300.0)
    named = Columns(errors=given, inputs=("bending",))
    assert read_recording(path, named, 300.0).input_names == ("t1", "t2", "bending")
    # A table of nothing but measured rows says nothing about its columns.
    path.write_text("\n".join([heading, *lines]), encoding="utf-8")
    assert read_recording(path, Columns(errors=given), 300.0).input_names == ("t1", "t2", "bending")


@pytest.mark.parametrize("written", ["%d.%m.%Y %H:%M", "excel", "%H:%M:%S on %Y-%m-%d"])
def test_times_are_read_as_they_are_written(tmp_path: Path, written: str) -> None:
    zone = ZoneInfo("Europe/Zurich")
    local = [(START + timedelta(minutes=5 * i)).astimezone(zone).replace(tzinfo=None) for i in range(40)]
    if written == "excel":
        times = [f"{(t - datetime(1899, 12, 30)) / timedelta(days=1):.9f}" for t in local]  # noqa: DTZ001
    else:
        times = [t.strftime(written) for t in local]
    path = table(tmp_path, "time,t1,t2,EX0C", times=times)
    found = read_recording(path, Columns(clock=TimeFormat(written, zone)), 300.0)
    assert found.start_utc_s == pytest.approx(START.timestamp(), abs=0.001)
    assert len(found.k) == 40
    with pytest.raises(RecordingError, match="is not a time; expected a time like %Y"):
        read_recording(path, Columns(clock=TimeFormat("%Y.%j")), 300.0)


def test_the_hour_that_a_night_has_twice_is_read_twice(tmp_path: Path) -> None:
    zone, begin = ZoneInfo("Europe/Zurich"), datetime(2026, 10, 24, 22, tzinfo=UTC)
    times = [(begin + timedelta(minutes=5 * i)).astimezone(zone).strftime("%Y-%m-%d %H:%M") for i in range(60)]
    path = table(tmp_path, "time,t1,t2,EX0C", rows=60, times=times)
    with pytest.raises(RecordingError, match=r"earlier than the time before it.*--time-zone, as in Europe/Zurich"):
        read_recording(path, Columns(), 300.0)
    found = read_recording(path, Columns(clock=TimeFormat(zone=zone)), 300.0)
    assert (np.diff(found.k) == 1).all()
    assert found.start_utc_s == begin.timestamp()
    answer = here("replay", path, "--time-zone", "Europe/Zuerich")
    assert answer.code == 2
    assert "unknown time zone" in answer.together


@pytest.mark.parametrize("decimals", [5, 8, 11])
def test_excel_s_days_tell_the_hour_twice_however_they_are_rounded(tmp_path: Path, decimals: int) -> None:
    zone, begin = ZoneInfo("Europe/Zurich"), datetime(2026, 10, 24, 22, tzinfo=UTC)
    local = [(begin + timedelta(minutes=5 * i)).astimezone(zone).replace(tzinfo=None) for i in range(60)]
    times = [f"{(t - datetime(1899, 12, 30)) / timedelta(days=1):.{decimals}f}" for t in local]  # noqa: DTZ001
    path = table(tmp_path, "time,t1,t2,EX0C", rows=60, times=times)
    found = read_recording(path, Columns(clock=TimeFormat("excel", zone)), 300.0)
    assert (np.diff(found.k) == 1).all()
    assert found.start_utc_s == pytest.approx(begin.timestamp(), abs=0.5)
    if decimals >= 8:
        assert found.start_utc_s == begin.timestamp()
        assert (
            here("replay", path, "--time-format", "excel", "--time-zone", zone.key, "--out", tmp_path / "o.csv").code
            == 0
        )
        assert all(datetime.fromisoformat(row["time"]).second == 0 for row in written(tmp_path / "o.csv"))


def test_a_file_of_several_days_has_gaps_at_night(tmp_path: Path) -> None:
    times = [(START + timedelta(days=d, minutes=5 * i)).isoformat() for d in range(3) for i in range(20)]
    found = read_recording(table(tmp_path, "time,t1,t2,EX0C", rows=60, times=times), Columns(), 300.0)
    assert found.k[-1] - found.k[0] == 2 * 288 + 19
    assert len(found.k) == 60


def written(path: Path) -> list[dict[str, Any]]:
    """Rows of a table by column; of a CSV file all are text."""
    if path.suffix == ".parquet":
        return list(pyarrow.parquet.read_table(path).to_pylist())
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_the_table_holds_each_step_and_contributions_add_up(tmp_path: Path, suffix: str) -> None:
    path, out = table(tmp_path, "time,t1,t2,lift"), tmp_path / f"steps{suffix}"
    answer = here("replay", path, "--error", "lift=lift", "--out", out)
    assert answer.code == 0, answer.together
    rows = written(out)
    assert list(rows[0]) == [
        "time", "k", "phase", "wanted", "lift", "lift_predicted", "lift_corrected", "lift_sigma", "lift_measured",
        "lift_trusted", "lift_from_t1", "lift_from_t2", "lift_level",
    ]  # fmt: skip
    assert [row["time"] for row in rows[:2]] == ["2026-03-02T06:00:00+00:00", "2026-03-02T06:05:00+00:00"]
    assert rows[1]["lift_measured"] in ("", None)
    models = written(tmp_path / f"steps-models{suffix}")
    assert list(models[0]) == [
        "error", "k", "part", "input", "time_constant_s", "delay_s", "weight", "sigma", "reference", "share",
    ]  # fmt: skip
    if suffix == ".parquet":
        empty = pyarrow.parquet.read_schema(tmp_path / "steps-models.parquet").field("delay_s")
        assert empty.type == pyarrow.float64()
    for row in rows:
        parts = sum(float(row[f"lift_{part}"]) for part in ("from_t1", "from_t2", "level"))
        assert parts == pytest.approx(float(row["lift_corrected"]), abs=1e-9)


def test_the_learner_s_weights_repeat_its_last_correction(tmp_path: Path) -> None:
    """By the lags as docs/control.md has them, over the recording's own columns."""
    path, out = table(tmp_path, "time,t1,t2,lift", rows=120), tmp_path / "steps.csv"
    assert here("replay", path, "--error", "lift=lift", "--out", out).code == 0
    models, last = written(tmp_path / "steps-models.csv"), written(out)[-1]
    assert len(models) == 2 + 2 * 5
    assert {(m["error"], m["k"]) for m in models} == {("lift", last["k"])}
    recorded, total = written(path), 0.0
    for m in models:
        lagged = 0.0 if m["part"] == "input" else 1.0
        for row in recorded[1:] if m["part"] == "input" else ():
            constant = float(m["time_constant_s"])
            kept = np.exp(-300.0 / constant) if constant else 0.0
            lagged = kept * lagged + (1.0 - kept) * (float(row[m["input"]]) - float(m["reference"]))
        total += float(m["weight"]) * lagged
        assert m["part"] == "smooth" or float(m["sigma"]) > 0.0
    assert float(models[0]["share"]) > 0.9
    assert float(models[0]["share"]) * total == pytest.approx(float(last["lift_corrected"]), abs=1e-9)


def test_a_trained_model_s_weights_are_its_equation_in_physical_units(tmp_path: Path) -> None:
    scaled = replace(
        model("EX0C"), u_mean=np.full(1, 22.0), u_std=np.full(1, 3.0), y_mean=4.0, y_std=1.5, intercept=0.2
    )
    kept = ModelSet(k=7, why="calibration", input_names=INPUTS, models=tuple(
        scaled if error == "EX0C" else None for error in THERMAL_ERRORS
    ))  # fmt: skip
    data = rehearse_recording(read_recording(table(tmp_path, "time,warm,idle,EX0C"), Columns(), 300.0), TalcSettings())
    found = learnt_columns(replace(data, models=(AdoptedModels(9, kept),)))
    rows = [dict(zip(found, row, strict=True)) for row in zip(*found.values(), strict=True)]
    assert {(row["error"], row["k"]) for row in rows} == {("EX0C", 9)}
    warm = np.concatenate([np.full(3, 20.0), np.linspace(20.0, 26.0, 30)])
    wanted = scaled.free_run(warm[:, None], np.full(33, np.nan), 4.5)
    y = [4.5] * 3
    for k in range(3, 33):
        past: dict[str, Any] = {"past": y, "input": warm}
        y.append(sum(
            row["weight"] * (1.0 if row["part"] == "level" else
            past[row["part"]][k - round(row["delay_s"] / 300.0)] - row["reference"])
            for row in rows
        ))  # fmt: skip
    np.testing.assert_allclose(y[25:], wanted[25:], rtol=1e-6)


def test_the_table_says_before_each_measurement_that_it_is_wanted(tmp_path: Path) -> None:
    out = tmp_path / "steps.csv"
    assert here("replay", table(tmp_path, "time,t1,t2,lift", rows=120), "--error", "lift=lift", "--out", out).code == 0
    rows = written(out)
    used = [k for k, row in enumerate(rows) if row["lift_measured"]]
    assert used == [0, *(k + 1 for k, row in enumerate(rows[:-1]) if row["wanted"])]
    assert 3 <= len(used) < 60, used
    assert {row["wanted"] for row in rows} <= {"", "interval", "uncertainty"}


def test_the_table_needs_a_known_suffix_and_overwrites_no_source(tmp_path: Path) -> None:
    path = table(tmp_path, "time,t1,t2,EX0C")
    assert (
        "expected a name that ends in .csv or .parquet"
        in here("replay", path, "--out", tmp_path / "steps.xlsx").together
    )
    assert "the table would overwrite" in here("replay", path, "--out", path).together
    beside = path.rename(tmp_path / "own-models.csv")
    assert "the table would overwrite" in here("replay", beside, "--out", tmp_path / "own.csv").together


@pytest.mark.parametrize("errors", [("E", "E_predicted"), ("phase", "lift"), ("lift", "lift_from_t1")])
def test_no_error_overwrites_a_column_of_the_table(tmp_path: Path, errors: tuple[str, str]) -> None:
    path, out = table(tmp_path, "time,t1,m1,m2"), tmp_path / "steps.csv"
    named = [
        word for error, column in zip(errors, ("m1", "m2"), strict=True) for word in ("--error", f"{error}={column}")
    ]
    answer = here("replay", path, *named, "--out", out)
    assert answer.code == 2
    assert re.search(r"steps\.csv: two columns would be called '.*'; --error NAME=COLUMN", answer.together)
    assert not out.exists()
    assert here("replay", path, *named).code == 0


@pytest.mark.parametrize(("option", "what"), [("--out", "table"), ("-o", "page")])
def test_a_folder_that_is_not_there_is_reported_before_anything_runs(tmp_path: Path, option: str, what: str) -> None:
    answer = here("replay", table(tmp_path, "time,t1,t2,EX0C"), option, tmp_path / "absent" / "steps.csv")
    assert answer.code == 2
    assert f"the {what} cannot be written: there is no folder" in " ".join(answer.together.split())
    assert "errors: EX0C" not in answer.together


@pytest.mark.slow
def test_the_calibration_interval_is_of_the_trained_models(tmp_path: Path) -> None:
    path, config = table(tmp_path, "time,t1,t2,EX0C"), tmp_path / "models.toml"
    refused = "own.csv: --calibration-interval: the learner has no calibration"
    assert refused in here("replay", path, "--calibration-interval", 30).together
    config.write_text('[talc]\nmethod = "models"\n', encoding="utf-8")
    assert (
        "--calibration-interval is for errors measured less often" in here("replay", path, "--config", config).together
    )
    assert (
        "expected a finite number" in here("replay", path, "--config", config, "--calibration-interval", "nan").together
    )
    rounded = here("replay", path, "--config", config, "--calibration-interval", 7).together
    assert "measured every 5 min instead of 7: in whole steps of 300 s" in rounded
    answer = here("replay", path, "--config", config, "--calibration-interval", 30)
    assert answer.code == 0, answer.together
    assert "whole steps" not in answer.together
    assert "288 steps of 300 s, 24.0 h, measured each 6 steps" in " ".join(answer.together.split())
    sparse = here("replay", path, "--config", config, "--calibration-interval", 180)
    assert "432 steps of 300 s, 36.0 h, measured each 36 steps" in " ".join(sparse.together.split()), "12 measurements"
