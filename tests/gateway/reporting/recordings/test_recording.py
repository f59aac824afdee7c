"""A user's own recording: problems are reported by line, column and value; a valid one runs as if live."""

import csv
import sys
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest

from gateway.config.file import load
from gateway.config.problems import ConfigError
from gateway.config.talc_only import load_talc_only
from gateway.control.replay.recorded import rehearse_recording
from gateway.reporting.recordings.columns import Columns
from gateway.reporting.recordings.grid import read_recording
from gateway.reporting.recordings.problems import RecordingError
from talc.frame import Phase
from talc.settings import ControlSettings, TalcSettings
from tests.benches.command import here
from tests.benches.thermal_series import series

START = datetime(2026, 3, 2, 6, 0, tzinfo=UTC)
GOOD = ["time,t1,EX0C"] + [f"{300 * i},{20 + i % 5},{i}" for i in range(1, 20)]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two days at 5 min, ISO times, three errors, of which EX0C is measured at every second step only."""
    made = series(576, 4)
    path = tmp_path_factory.mktemp("recording") / "lathe.csv"
    with path.open("w", newline="", encoding="utf-8") as file:
        out = csv.writer(file)
        out.writerow(["time", *made.names, "EX0C_um", "EZ0T", "EA0C_um_per_m"])
        for k in range(576):
            at = (START + timedelta(minutes=5 * k)).isoformat()
            errors = [made.measured[k, 2] if k % 2 else "", made.measured[k, 4], made.measured[k, 6]]
            out.writerow([at, *made.inputs[k], *errors])
    return path


@pytest.mark.slow
def test_a_recording_becomes_a_table_and_a_page(recorded: Path, tmp_path: Path) -> None:
    page, config = tmp_path / "page.html", tmp_path / "talc.toml"
    config.write_text('[talc]\nmethod = "models"\n', encoding="utf-8")
    answer = here("replay", recorded, "--config", config, "-o", page)
    assert answer.code == 0, answer.together
    assert "EX0C held" in answer.together
    assert "EY0A" not in answer.together
    text = page.read_text(encoding="utf-8")
    assert text.count('<div class="still"><svg') == 4  # three errors and the inputs
    for label in ("recorded", "used as a measurement", "recorded minus predicted"):
        assert text.count(f">{label}</text>") == 3
    assert "simulated truth</text>" not in text


def test_only_measurements_that_were_asked_for_reach_the_controller(recorded: Path) -> None:
    recording = read_recording(recorded, Columns(), 300.0)
    data = rehearse_recording(
        recording, TalcSettings(method="models", control=ControlSettings(measurement_interval_steps=24))
    )
    assert data.phases[300] is Phase.COMPENSATION
    used = np.flatnonzero(np.isfinite(data.measured[:, 4])) - 288
    steps = used[used > 0]
    assert len(steps) < 60
    assert data.recorded is not None
    assert np.isfinite(data.recorded[:, 4]).all()
    everything = rehearse_recording(recording, TalcSettings(method="models"), every_measurement=True)
    assert np.isfinite(everything.measured[:, 4]).all()


def test_the_models_beat_the_held_measurement(recorded: Path) -> None:
    data = rehearse_recording(read_recording(recorded, Columns(), 300.0), TalcSettings(method="models"))
    assert data.held is not None
    assert data.recorded is not None
    left, held = (data.recorded - data.predicted)[300:, 4], (data.recorded - data.held)[300:, 4]
    assert np.sqrt(np.mean(left**2)) < 0.6 * np.sqrt(np.mean(held**2))


def test_parquet_semicolons_and_commas_say_the_same_as_csv(recorded: Path, tmp_path: Path) -> None:
    plain = read_recording(recorded, Columns(), 300.0)
    with recorded.open(newline="", encoding="utf-8") as file:
        head, *rows = list(csv.reader(file))
    german = tmp_path / "german.csv"
    lines = [";".join(head), *(";".join([r[0], *(c.replace(".", ",") for c in r[1:])]) for r in rows)]
    german.write_text("\ufeff" + "\r\n".join(lines) + "\r\n", encoding="utf-8")
    columns: dict[str, object] = {"time": [datetime.fromisoformat(r[0]) for r in rows]}
    columns |= {name: [float(r[i]) if r[i] else None for r in rows] for i, name in enumerate(head) if i}
    parquet = tmp_path / "recording.parquet"
    pyarrow.parquet.write_table(pyarrow.table(columns), parquet)
    for other in (german, parquet):
        same = read_recording(other, Columns(), 300.0)
        assert same.input_names == plain.input_names
        assert np.array_equal(same.k, plain.k)
        assert np.array_equal(same.inputs, plain.inputs)
        assert np.array_equal(same.errors, plain.errors, equal_nan=True)


def test_a_fast_recording_is_averaged_and_its_gaps_stay(tmp_path: Path) -> None:
    seconds = [s for s in range(0, 9000, 60) if not 3000 < s <= 4200]
    lines = ["time,t1,EX0C", *(f"{s},{s},{s if s % 120 == 0 else ''}" for s in seconds)]
    path = tmp_path / "fast.csv"
    path.write_text("\n".join(lines), encoding="utf-8")
    recording = read_recording(path, Columns(), 300.0)
    assert {11, 12, 13, 14}.isdisjoint(recording.k.tolist())
    row = recording.k.tolist().index(2)  # the step from 300 (not within) to 600 s
    assert recording.inputs[row, 0] == pytest.approx(np.mean([360, 420, 480, 540, 600]))
    assert recording.errors[row, 2] == 600.0
    slow = read_recording(path, Columns(), 30.0)
    assert slow.step_s == 60.0


def test_errors_and_time_by_their_names(tmp_path: Path) -> None:
    path = tmp_path / "own.csv"
    lines = ["clock\tdrift\tt1\tcomment", *(f"{300 * i}\t{i}\t{20 + i % 3}\tx" for i in range(20))]
    path.write_text("\n".join(lines), encoding="utf-8")
    recording = read_recording(path, Columns("clock", {"EZ0T": "drift"}, ("comment",)), 300.0)
    assert recording.input_names == ("t1",)
    assert recording.errors[5, 4] == 5.0
    assert here("replay", path, "--time", "clock", "--error", "EZ0T=drift", "--ignore", "comment").code == 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda g: [*g[:3], "900,2O.5,1", *g[4:]], "line 4, column 't1': '2O.5' is not a finite number"),
        (lambda g: [*g[:3], "900,20,inf", *g[4:]], "line 4, column 'EX0C': 'inf' is not a finite number"),
        (
            lambda g: [*g[:3], "600,20,1", *g[4:]],
            "line 4, column 'time': has the time of the row before it, but other values; give each row",
        ),
        (lambda g: [*g[:3], "soon,20,1", *g[4:]], "line 4, column 'time': 'soon' is not a time; expected ISO 8601"),
        (lambda g: [*g[:3], "900,20", *g[4:]], "line 4: 2 cells; the heading has 3"),
        (lambda g: ["time,t1,t1", *g[1:]], "column 3: 't1' occurs twice"),
        (lambda g: ["time,,EX0C", *g[1:]], "column 2: has no name"),
        (
            lambda g: ["Time,t1,EX0C", *g[1:]],
            "column 'time': is missing; --time NAME says which column is the time; did you mean 'Time'?",
        ),
        (lambda g: ["time,t1,t2", *g[1:]], "no column of a thermal error; expected one or more of EY0A"),
        (lambda g: ["time,EY0A,EX0C", *g[1:]], "no column remains as an input"),
        (lambda g: [*g[:3], "900,2_0,1", *g[4:]], "line 4, column 't1': '2_0' is not a finite number"),
        (
            lambda g: [*g[:3], "900,20,1e200", *g[4:]],
            "line 4, column 'EX0C': '1e200' is beyond 1e+06, the largest allowed",
        ),
        (
            lambda g: [*g[:3], "900,1e308,1", *g[4:]],
            "line 4, column 't1': '1e308' is beyond 1e+12, the largest allowed",
        ),
        (lambda g: [*g, "1e300,20,1"], "line 21, column 'time': '1e300' is not within the years 1900 to 2200"),
        (
            lambda g: [g[0], "1772431500000,20,1", *g[1:]],
            "line 2, column 'time': '1772431500000' is not within the years 1900 to 2200; are these milliseconds?",
        ),
        (
            lambda g: [*g, "1e18,20,1"],
            "line 21, column 'time': '1e18' is not within the years 1900 to 2200; are these nano",
        ),
        (
            lambda g: [g[0], "0001-01-01T00:00:00+05:00,20,1", *g[1:]],
            "line 2, column 'time': '0001-01-01T00:00:00+05:00' is not within the years 1900 to 2200",
        ),
        (lambda g: [*g[:3], '900,"20,1', *g[4:]], "line 4: cannot be split into cells: is a quote"),
        (lambda g: [*g[:3], '900,20,"1', *g[4:9], '1,2,"', *g[9:]], "line 4, column 'EX0C': '1\\n1200"),
        (
            lambda g: [*g[:3], '900,"20,1', *(f"{300 * i},{'2' * 60},1" for i in range(6, 4000))],
            "line 4: cannot be split into cells: is a quote",
        ),
        (
            lambda g: [g[0], *(f"{46083 + i / 288},20,{i}" for i in range(20))],
            "20 lines fill 1 steps of 300 s; expected 12 or more; "
            "are the times in s? --time-unit h is for hours, --time-format excel for Excel's dates",
        ),
        (lambda g: g[:6], "5 lines fill 5 steps of 300 s; expected 12 or more"),
        (lambda g: g[:1], "contains nothing but a heading"),
        (lambda g: g[:0], "is empty; expected a heading"),
    ],
)
def test_what_is_wrong_is_reported_with_its_place(
    tmp_path: Path, change: Callable[[list[str]], list[str]], message: str
) -> None:
    path = tmp_path / "bad.csv"
    path.write_text("\n".join(change(GOOD)), encoding="utf-8")
    answer = here("replay", path)
    assert answer.code == 2
    assert f"{path}: {message}" in answer.together.replace("\n", " ").replace("  ", " ")


def test_many_mistakes_are_counted_and_other_files_named(tmp_path: Path) -> None:
    path = tmp_path / "bad.csv"
    path.write_text("\n".join([GOOD[0], *(line.replace(",", ",x") for line in GOOD[1:])]), encoding="utf-8")
    with pytest.raises(RecordingError, match="and 32 more"):
        read_recording(path, Columns(), 300.0)
    path.write_bytes(b"\x89PNG\r\n\x1a\n\xff")
    with pytest.raises(RecordingError, match="line 1: is neither Parquet nor UTF-8 text: byte 1 of the line is 0x89"):
        read_recording(path, Columns(), 300.0)
    path.write_bytes(b"PAR1 cut")
    with pytest.raises(RecordingError, match="is not a readable Parquet file"):
        read_recording(path, Columns(), 300.0)
    answer = here("replay", path, "--error", "EX")
    assert answer.code == 2
    assert "expected NAME=COLUMN" in answer.together


def test_bytes_that_are_no_text_are_reported_by_line(tmp_path: Path) -> None:
    path = tmp_path / "strange.csv"
    for strange in (b"\x81", b"\xff\x00"):  # Windows-1252 leaves the first out; text has no NUL
        path.write_bytes("\n".join([*GOOD[:4], "1500,20,1 "]).encode() + strange)
        with pytest.raises(RecordingError, match=rf"line 5: is neither .*: byte 11 of the line is 0x{strange[0]:x}; "):
            read_recording(path, Columns(), 300.0)
    # UTF-8 with a byte that Windows-1252 leaves out, above a line that is no UTF-8: neither fits both.
    path.write_bytes("\n".join([*GOOD[:3], "900,20,1 \u010f"]).encode() + b"\n1200,20,1\xb0")
    with pytest.raises(RecordingError, match=r"line 5: is neither .*: byte 10 of the line is 0xb0; "):
        read_recording(path, Columns(), 300.0)
    path.write_bytes(b"\xff\xfet\x00i")
    with pytest.raises(RecordingError, match="is not valid UTF-16"):
        read_recording(path, Columns(), 300.0)


def test_a_page_overwrites_nothing_that_it_is_made_from(tmp_path: Path) -> None:
    path, config = tmp_path / "table.html", tmp_path / "talc.toml"
    path.write_text("\n".join(GOOD), encoding="utf-8")
    config.write_text("[grid]\nstep_s = 300\n", encoding="utf-8")
    for options in ([], ["-o", tmp_path / "." / "table.html"], ["--config", config, "-o", config]):
        answer = here("replay", path, *options)
        assert answer.code == 2
        assert "give it another name with -o" in answer.together
    assert path.read_text(encoding="utf-8") == "\n".join(GOOD)
    assert here("replay", path, "-o", tmp_path / "page.html").code == 0


def test_timestamps_of_parquet_need_neither_pandas_nor_their_zone(tmp_path: Path) -> None:
    begin = int(START.timestamp())
    for unit, parts, more in (("s", 1, 0), ("ms", 10**3, 1), ("us", 10**6, 1), ("ns", 10**9, 123)):
        times = pyarrow.array(
            [(begin + 300 * i) * parts + more for i in range(20)], pyarrow.timestamp(unit, "No/Where")
        )
        path = tmp_path / f"{unit}.parquet"
        columns = {"time": times, "t1": [float(i) for i in range(20)], "EX0C": [1.0] * 20}
        pyarrow.parquet.write_table(pyarrow.table(columns), path)
        recording = read_recording(path, Columns(), 300.0)
        assert recording.k.tolist() == [begin // 300 + i for i in range(20)]
        assert recording.start_utc_s == pytest.approx(begin, abs=0.01)
    pyarrow.parquet.write_table(pyarrow.table(columns | {"stamp": times}), path)
    with pytest.raises(RecordingError, match=r"column 'stamp': holds .*, not numbers; --ignore 'stamp' leaves it out"):
        read_recording(path, Columns(), 300.0)


def test_a_signalling_nan_in_parquet_is_a_missing_value(tmp_path: Path) -> None:
    t1, path = np.arange(20.0), tmp_path / "nan.parquet"
    t1[3:4].view(np.uint64)[0] = 0x7FF0_0000_0000_0001
    times = [START + timedelta(minutes=5 * i) for i in range(20)]
    pyarrow.parquet.write_table(pyarrow.table({"time": times, "t1": t1, "EX0C": [1.0] * 20}), path)
    recording = read_recording(path, Columns(), 300.0)
    assert np.flatnonzero(np.isnan(recording.inputs[:, 0])).tolist() == [3]


def test_text_in_parquet_is_reported_by_row(tmp_path: Path) -> None:
    path = tmp_path / "bad.parquet"
    times = [START + timedelta(minutes=5 * i) for i in range(20)]
    pyarrow.parquet.write_table(pyarrow.table({"time": times, "t1": ["hot"] * 20, "EX0C": [1.0] * 20}), path)
    with pytest.raises(RecordingError, match="row 1, column 't1': 'hot'"):
        read_recording(path, Columns(), 300.0)


def test_without_pyarrow_parquet_is_refused_with_what_to_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "some.parquet"
    path.write_bytes(b"PAR1")
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(RecordingError, match="`parquet`"):
        read_recording(path, Columns(), 300.0)


@pytest.mark.parametrize("key", ['calibration_steps = "300"', "calibration_steps = 300.5", "calibration_steps = true"])
def test_a_configuration_for_replay_is_read_as_strictly_as_one_to_run(tmp_path: Path, key: str) -> None:
    config = tmp_path / "talc.toml"
    config.write_text(f"[talc.control]\n{key}\n", encoding="utf-8")
    with pytest.raises(ConfigError) as replayed:
        load_talc_only(config)
    whole = tmp_path / "gateway.toml"
    whole.write_text(f'[machine]\nname = "mill"\n[talc.control]\n{key}\n', encoding="utf-8")
    with pytest.raises(ConfigError) as run:
        load(whole)
    assert replayed.value.problems == run.value.problems
    assert replayed.value.problems[0].where == "[talc.control] calibration_steps"


def test_settings_come_from_a_configuration_and_too_little_is_reported(tmp_path: Path) -> None:
    path, config = tmp_path / "short.csv", tmp_path / "talc.toml"
    path.write_text("\n".join(GOOD), encoding="utf-8")
    config.write_text('[talc]\nmethod = "models"\n', encoding="utf-8")
    answer = here("replay", path, "--config", config)
    assert "no correction has begun" in answer.together
    config.write_text("[grid]\nstep_s = 300\n[talc.control]\ncalibration_step = 12\n[nc]\n", encoding="utf-8")
    answer = here("replay", path, "--config", config)
    assert answer.code == 2
    assert "did you mean 'calibration_steps'?" in answer.together
