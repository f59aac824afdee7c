"""Reading of described recordings: units, gaps, runs, cells of unknown quality, and reported problems."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.recordings.description import recordings_in
from benchmarks.recordings.series import read_series
from benchmarks.recordings.subject import SHIPPED
from gateway.config.problems import ConfigError
from gateway.reporting.recordings.problems import RecordingError


def written(folder: Path, toml: str, lines: list[str], name: str = "lathe") -> Path:
    (folder / f"{name}.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    path = folder / f"{name}.toml"
    path.write_text(toml, encoding="utf-8")
    return path


def rows_each(step_s: int, count: int, start_s: int = 0) -> list[str]:
    """time, t1, drift: t1 is the minute, drift half of it."""
    return [f"{start_s + i * step_s},{i * step_s / 60},{i * step_s / 120}" for i in range(count)]


HEAD = "time,t1,drift"


def test_faster_rows_are_averaged_over_the_step_that_they_end_in(tmp_path: Path) -> None:
    path = written(tmp_path, 'errors = ["drift"]\nreference = "recorded"', [HEAD, *rows_each(60, 200)])
    _, series = read_series(path)
    # The first step contains only 0 s, the next one 60 to 300 s: minutes 1 to 5.
    assert series.inputs[:3, 0].tolist() == [0.0, 3.0, 8.0]
    assert series.truth[:3, 0].tolist() == [0.0, 1.5, 4.0]
    assert series.k[:3].tolist() == [0, 1, 2]


@pytest.mark.parametrize(("unit", "in_a_second"), [("ns", 1e9), ("us", 1e6), ("µs", 1e6), ("ms", 1e3), ("h", 1 / 3600)])
def test_times_are_converted(tmp_path: Path, unit: str, in_a_second: float) -> None:
    lines = [f"{i * 300 * in_a_second},{i * 5.0},{i * 2.5}" for i in range(40)]
    toml = f'errors = ["drift"]\ntime.unit = "{unit}"'
    _, series = read_series(written(tmp_path, toml, [HEAD, *lines]))
    assert series.step_s == pytest.approx(300.0)
    assert np.diff(series.k).tolist() == [1] * (len(series.k) - 1)
    assert len(series.k) == 40


def test_the_last_value_of_a_step_is_taken_where_that_is_wanted(tmp_path: Path) -> None:
    path = written(tmp_path, 'errors = ["drift"]\nsampling = "last"', [HEAD, *rows_each(60, 200)])
    _, series = read_series(path)
    assert series.inputs[:3, 0].tolist() == [0.0, 5.0, 10.0]


@pytest.mark.parametrize(
    ("unit", "scale", "angle"),
    [
        ("mm", 1000.0, False),
        ("nm", 0.001, False),
        ("in", 25400.0, False),
        ("µm", 1.0, False),
        ("um/m", 1.0, True),
        ("μrad", 1.0, True),
        ("arcsec", np.pi / 180 / 3600 * 1e6, True),
    ],
)
def test_errors_noise_and_probing_are_converted(tmp_path: Path, unit: str, scale: float, angle: bool) -> None:
    toml = f'errors = ["drift"]\nunit = "{unit}"\nnoise = 0.3\nprobing = 0.4'
    lines = [f"{i * 300},{i * 5},{i * 0.25}" for i in range(40)]
    _, series = read_series(written(tmp_path, toml, [HEAD, *lines]))
    assert series.truth[2, 0] == pytest.approx(0.5 * scale)
    assert series.noise[0] == pytest.approx(0.3 * scale)
    assert series.probing[0] == pytest.approx(0.4 * scale)
    assert series.angle.tolist() == [angle]


def test_one_error_may_differ_from_what_is_said_of_all(tmp_path: Path) -> None:
    toml = 'noise = 0.1\n[errors]\ndrift = {}\nyaw = { unit = "mrad", noise = 0.002 }'
    lines = [HEAD + ",yaw", *(f"{line},{i / 1000}" for i, line in enumerate(rows_each(300, 40)))]
    _, series = read_series(written(tmp_path, toml, lines))
    assert series.noise.tolist() == [0.1, 2.0]
    assert series.truth[3].tolist() == pytest.approx([7.5, 3.0])
    assert series.input_names == ("t1",)


def test_a_silence_begins_a_run_and_counts_in_full(tmp_path: Path) -> None:
    night_s = 14 * 3600
    day = rows_each(300, 30)
    next_day = rows_each(300, 30, start_s=29 * 300 + night_s)
    _, series = read_series(written(tmp_path, 'errors = ["drift"]', [HEAD, *day, *next_day]))
    assert series.run.tolist() == [0] * 30 + [1] * 30
    assert int(series.k[30] - series.k[29]) == night_s // 300
    # Recorded hours do not count the night.
    assert series.on_h[-1] == pytest.approx(59 * 300 / 3600)


def test_each_run_may_count_from_its_own_first_value(tmp_path: Path) -> None:
    lines = [HEAD, *rows_each(300, 40), *rows_each(300, 40, start_s=100_000)]
    _, series = read_series(written(tmp_path, 'errors = ["drift"]\nreference = "run"', lines))
    begins = np.flatnonzero(np.diff(series.run)) + 1
    assert (len(begins), series.zero_each_run) == (1, True)
    assert series.truth[0, 0] == series.truth[begins[0], 0] == 0.0
    assert series.truth[-1, 0] == pytest.approx(39 * 300 / 120)


def test_time_that_begins_again_needs_the_hours_off(tmp_path: Path) -> None:
    lines = ["run,time,t1,drift"]
    lines += [f"{run},{line}" for run in (1, 2, 3) for line in rows_each(300, 20)]
    toml = 'errors = ["drift"]\n[runs]\ncolumn = "run"\n'
    with pytest.raises(ConfigError, match=r"lathe\.toml: \[runs\] off_h: missing: time starts again at line 22"):
        read_series(written(tmp_path, toml, lines))
    _, series = read_series(written(tmp_path, toml + "off_h = [8.0, 60.0]", lines))
    assert series.run.tolist() == [0] * 20 + [1] * 20 + [2] * 20
    assert [int(series.k[i] - series.k[i - 1]) for i in (20, 40)] == [8 * 12, 60 * 12]
    assert series.input_names == ("t1",)
    with pytest.raises(ConfigError, match="has 1 entries; time starts again 2 times"):
        read_series(written(tmp_path, toml + "off_h = [8.0]", lines))


def test_date_times_of_a_logger_are_read(tmp_path: Path) -> None:
    lines = ["when;t1;drift", *(f"03.05.2022 {6 + i // 12:02}:{i % 12 * 5:02};{i},5;{i}" for i in range(40))]
    toml = 'errors = ["drift"]\n[time]\ncolumn = "when"\nformat = "%d.%m.%Y %H:%M"'
    _, series = read_series(written(tmp_path, toml, lines))
    assert len(series.k) == 40
    assert series.inputs[1, 0] == 1.5
    assert series.k[-1] == 39


def test_slower_rows_keep_their_own_step(tmp_path: Path) -> None:
    _, series = read_series(written(tmp_path, 'errors = ["drift"]', [HEAD, *rows_each(600, 40)]))
    assert series.step_s == 600.0
    assert len(series.k) == 40
    assert "600 s apart" in series.notes[0]


def test_cells_of_unknown_quality(tmp_path: Path) -> None:
    """Missing and strange input cells are missing; columns of text and empty ones are left out, and named."""
    lines = ["time,t1,t2,operator,spare,drift"]
    lines += [
        f"{i * 300},{'' if i == 3 else i},{'OVL' if i == 4 else 7},Jo,,{'NaN' if i == 5 else i}" for i in range(40)
    ]
    _, series = read_series(written(tmp_path, 'errors = ["drift"]', lines))
    assert series.input_names == ("t1", "t2")
    assert np.flatnonzero(np.isnan(series.inputs).any(axis=1)).tolist() == [3, 4]
    assert np.flatnonzero(np.isnan(series.truth[:, 0])).tolist() == [5]
    assert any("'t2': 1 cells are not numbers" in note for note in series.notes)
    assert any("'operator': 40 of 40" in note for note in series.notes)
    assert any("'spare': empty" in note for note in series.notes)


def test_patterns_choose_inputs_and_say_what_they_are(tmp_path: Path) -> None:
    lines = ["time,t1,t2,rpm,load,drift", *(f"{i * 300},1,2,{i},5,{i}" for i in range(40))]
    toml = 'errors = ["drift"]\nignore = ["l*"]\n'
    toml += '[inputs]\nrpm = { kind = "speed", span = 5000 }\n"*" = { kind = "temperature" }'
    _, series = read_series(written(tmp_path, toml, lines))
    assert series.input_names == ("t1", "t2", "rpm")
    assert [said.kind for said in series.about] == ["temperature", "temperature", "speed"]
    assert series.about[2].span == 5000


@pytest.mark.parametrize(
    ("toml", "said"),
    [
        ('errors = ["drfit"]', "errors: the recording has no column 'drfit'; did you mean 'drift'?"),
        ('errors = ["drift"]\ninputs = ["t9"]', "inputs: the recording has no column 't9'; possible: drift, t1, time"),
        ('errors = ["drift"]\nunit = "inch"', "unit: 'inch' is invalid"),
        ('errors = ["drift"]\ntime.unit = "hour"', "unit: 'hour' is invalid"),
        ('errors = ["drift"]\nnoise = -1', "noise: -1: expected at least 0"),
        ('errors = ["drift"]\nsigma = 1', "sigma: unknown key"),
        ("step_s = 300", "errors: missing"),
        ('errors = ["drift"]\nfile = "other.csv"', "file: other.csv is not beside it"),
        ('errors = ["drift"]\n[time]\ncolumn = "zeit"', "time, column: the recording has no column 'zeit'"),
        ('errors = ["drift"]\ninputs = ["x*"]', "inputs: no column of numbers remains as an input in lathe.csv"),
        ("errors = [", "is not valid TOML"),
    ],
)
def test_a_wrong_description_is_reported_with_file_field_and_value(tmp_path: Path, toml: str, said: str) -> None:
    path = written(tmp_path, toml, [HEAD, *rows_each(300, 40)])
    with pytest.raises(ConfigError) as caught:
        read_series(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("12000,1.0,broken", "lathe.csv: line 42, column 'drift': 'broken' is not a number"),
        ("noon,1.0,1.0", "lathe.csv: line 42, column 'time': 'noon' is not a time"),
        ("60,1.0,1.0", "lathe.csv: line 42, column 'time': '60' comes before '11700' of the row above; sort the rows"),
        ("12000,1.0,2e9", "lathe.csv: line 42, column 'drift': '2e9' is beyond 1e+06; is its unit right?"),
    ],
)
def test_a_wrong_cell_is_reported_with_line_column_and_value(tmp_path: Path, line: str, said: str) -> None:
    path = written(tmp_path, 'errors = ["drift"]', [HEAD, *rows_each(300, 40), line])
    with pytest.raises(RecordingError) as caught:
        read_series(path)
    assert said in str(caught.value)


def test_parquet_is_read_and_columns_without_numbers_are_left_out(tmp_path: Path) -> None:
    import pyarrow as pa
    from pyarrow import parquet

    stamps = pa.array([1_650_000_000_000 + i * 300_000 for i in range(40)], pa.timestamp("ms"))
    table = pa.table(
        {
            "time": stamps,
            "t1": pa.array([float(i) for i in range(40)]),
            "serviced": stamps,
            "drift": pa.array([None if i == 2 else i for i in range(40)]),
        }
    )
    parquet.write_table(table, tmp_path / "mill.parquet")
    (tmp_path / "mill.toml").write_text('errors = ["drift"]')
    _, series = read_series(tmp_path / "mill.toml")
    assert series.input_names == ("t1",)
    assert len(series.k) == 40
    assert np.flatnonzero(np.isnan(series.truth[:, 0])).tolist() == [2]


def test_the_shipped_recording_is_whole() -> None:
    (path,) = recordings_in(SHIPPED)
    said, series = read_series(path)
    assert series.truth.shape == (557, 5)
    assert len(series.input_names) == 17
    assert np.isfinite(series.inputs).all()
    assert np.diff(series.k).tolist() == [1] * 556
    assert (SHIPPED / "LICENSE").read_text(encoding="utf-8").startswith("MIT License")
    assert said.probing == 1.0


def test_a_logger_s_settings_units_and_words_are_left_out(tmp_path: Path) -> None:
    rows = rows_each(300, 40)
    rows[3], rows[4] = "900,OVL,---", "1200,9999,2"
    lines = ["made by a logger", HEAD, "s,degC,um", *rows]
    said = 'errors = ["drift"]\nskip = ["1,3"]\nmissing = ["OVL", "9999"]\nreference = "recorded"'
    _, series = read_series(written(tmp_path, said, lines))
    assert np.isnan(series.inputs[3:5, 0]).all()
    assert np.isnan(series.truth[3, 0])
    assert len(series.k) == 40
    with pytest.raises(ConfigError, match="'none': expected a line or lines, such as 1-3 or 5"):
        read_series(written(tmp_path, said.replace("1,3", "none"), lines))


_IN_MM = ["time,t1,dz [mm]", *(f"{300 * i},{20 + i},{0.001 * i}" for i in range(40))]


@pytest.mark.parametrize(
    ("said", "um", "read"),
    [
        ('errors = ["dz [mm]"]', 3.0, "read in mm"),
        ('errors = ["dz [mm]"]\nunit = "mm"', 3.0, "read in mm"),
        ('[errors]\n"dz [mm]" = { unit = "um" }', 0.003, "read in µm"),
        ('unit = "um"\n[errors]\n"dz [mm]" = { unit = "mm" }', 3.0, "read in mm"),
    ],
)
def test_an_error_is_read_in_the_unit_of_its_name_unless_the_file_says_one(
    tmp_path: Path, said: str, um: float, read: str
) -> None:
    _, series = read_series(written(tmp_path, said, _IN_MM))
    assert series.truth[3, 0] == pytest.approx(um)
    assert series.units_read == read
    assert series.noise[0] == 0.5, "the default is 0.5 µm, whatever the unit"


def test_a_name_that_contradicts_the_unit_of_all_errors_is_refused_with_a_remedy(tmp_path: Path) -> None:
    path = written(tmp_path, 'errors = ["dz [mm]"]\nunit = "um"', _IN_MM)
    with pytest.raises(ConfigError) as found:
        read_series(path)
    remedy = str(found.value).partition("[errors]: ")[2].strip()
    path.write_text(f'unit = "um"\n[errors]\n{remedy}\n', encoding="utf-8")
    _, series = read_series(path)
    assert series.truth[3, 0] == pytest.approx(3.0)


def test_errors_in_different_units_are_named_with_theirs(tmp_path: Path) -> None:
    lines = ["time,t1,dx,dz_mm,yaw [urad]", *(f"{300 * i},{20 + i},{i},{0.001 * i},{i}" for i in range(40))]
    _, series = read_series(written(tmp_path, 'errors = ["dx", "dz_mm", "yaw [urad]"]', lines))
    assert series.units_read == "read dx in µm; dz_mm in mm; yaw [urad] in µrad"
    assert series.angle.tolist() == [False, False, True]


def test_cells_that_a_fault_has_made_are_named_with_column_and_count(tmp_path: Path) -> None:
    lines = [f"{i * 300},{20.0 + 0.1 * i:.1f},{5.0 + 0.2 * i:.1f},{0.3 * i:.1f}" for i in range(100)]
    for i in (60, 61, 70):
        lines[i] = f"{i * 300},85.0,{5.0 + 0.2 * i:.1f},{0.3 * i:.1f}"
    _, series = read_series(written(tmp_path, 'errors = ["drift"]\nunit = "um"', ["time,t1,t2,drift", *lines]))
    (note,) = [note for note in series.notes if "t1" in note or "t2" in note]
    assert ("'t1'" in note, "3 steps" in note, f"{60 / 12} h" in note, "power_on" in note) == (True,) * 4
