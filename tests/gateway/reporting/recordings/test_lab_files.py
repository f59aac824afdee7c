"""Recordings as laboratories keep them: encodings, blocks of settings, units, unknown values, repeated rows."""

import csv
from collections.abc import Sequence
from datetime import datetime, timedelta
from pathlib import Path
from zoneinfo import ZoneInfo

import numpy as np
import pyarrow
import pytest

from gateway.model.codes import NoticeCode
from gateway.model.text import Text
from gateway.reporting.recordings.columns import Columns
from gateway.reporting.recordings.grid import Recording, read_recording
from gateway.reporting.recordings.layout import TextLayout
from gateway.reporting.recordings.problems import RecordingError
from gateway.reporting.recordings.times import TimeFormat
from tests.benches.command import here

ROWS = 40
TEMPERATURE = [f"{20 + i % 7 / 10:.1f}" for i in range(ROWS)]
SECONDS = [str(300 * i) for i in range(ROWS)]
FIVE = Columns()


def lines(heading: str, times: Sequence[str] = SECONDS, separator: str = ",") -> list[str]:
    rows = zip(times, TEMPERATURE, strict=True)
    return [heading, *(separator.join([time, value, str(i % 5)]) for i, (time, value) in enumerate(rows))]


def written(folder: Path, text: Sequence[str], encoding: str = "utf-8") -> Path:
    path = folder / "lab.csv"
    path.write_bytes("\n".join(text).encode(encoding))
    return path


def read(path: Path, columns: Columns = FIVE) -> Recording:
    return read_recording(path, columns, 300.0)


def refusal(path: Path, columns: Columns = FIVE) -> str:
    with pytest.raises(RecordingError) as refused:
        read(path, columns)
    return str(refused.value)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-32", "cp1252"])
def test_every_usual_encoding_is_read(tmp_path: Path, encoding: str) -> None:
    found = read(written(tmp_path, lines("time,Kühlung [°C],EZ0T"), encoding))
    assert found.input_names == ("Kühlung [°C]",)
    assert len(found.k) == ROWS
    assert [note.code for note in found.notes] == ([NoticeCode.READ_AS_WINDOWS_1252] if encoding == "cp1252" else [])


@pytest.mark.parametrize("separator", [";", "\t", " "])
def test_a_decimal_comma_is_one_with_every_separator_but_the_comma(tmp_path: Path, separator: str) -> None:
    text = [line.replace(".", ",") for line in lines(separator.join(["time", "t1", "EZ0T"]), separator=separator)]
    assert np.array_equal(read(written(tmp_path, text)).inputs[:, 0], np.array(TEMPERATURE, dtype=float))


def test_spaces_may_be_many_and_stand_at_both_ends(tmp_path: Path) -> None:
    text = [f"  {line}  " for line in lines("time   t1  EZ0T", separator="   ")]
    assert read(written(tmp_path, text)).input_names == ("t1",)


@pytest.mark.parametrize(("thousand", "decimal"), [("3.000", "20,5"), ("3,000", "20.5")])
def test_three_thousand_is_not_read_as_three(tmp_path: Path, thousand: str, decimal: str) -> None:
    text = ["time;speed;t1;EZ0T", *(f"{s};{thousand if i % 2 else 0};{decimal};1" for i, s in enumerate(SECONDS))]
    said = refusal(written(tmp_path, text))
    assert f"line 3, column 'speed': '{thousand}' may be a number with thousands separated" in said
    alike = [line.replace(decimal, decimal.replace(",", ".")) for line in text if "." in thousand]
    if alike:  # without a decimal comma anywhere the point is the decimal mark
        assert read(written(tmp_path, alike)).inputs[1, 0] == 3.0


def test_excel_s_own_first_line_and_a_separator_at_each_end(tmp_path: Path) -> None:
    text = ["sep=;", *(f"{line};" for line in lines("time;t1;EZ0T", separator=";"))]
    found = read(written(tmp_path, text))
    assert (found.input_names, len(found.k)) == (("t1",), ROWS)
    text[5] += "7"
    assert "line 6: 4 cells; the heading has 3; --skip 6 leaves the line out" in refusal(written(tmp_path, text))


def test_an_enormous_cell_among_the_lines_is_reported_with_its_place(tmp_path: Path) -> None:
    text = lines("time,t1,EZ0T")
    text[5] = '"' + 200_000 * "x" + '",1,2'
    assert "line 6" in refusal(written(tmp_path, text))


def test_a_block_of_settings_and_a_row_of_units_are_seen_and_skipped(tmp_path: Path) -> None:
    table = lines("X_Value\tfront\tdisp_Z", separator="\t")
    table.insert(1, "s\tdegC\tum")
    path = written(tmp_path, ["LabVIEW Measurement\t", "Operator\tMaier", "", *table])
    answer = here("replay", path)
    assert answer.code == 2
    assert "the table seems to begin on line 4 (X_Value, front, disp_Z): --skip 1-3,5" in answer.together
    answer = here("replay", path, "--skip", "1-3,5", "--time", "X_Value", "--error", "Z=disp_Z")
    assert answer.code == 0, answer.together
    assert "--skip 1-3,5" in path.with_suffix(".html").read_text("utf-8")
    assert "the table seems to begin on line 1 (time, t1, EZ0T): --skip 2" in refusal(
        written(tmp_path, [*lines("time,t1,EZ0T")[:1], "s,degC,um", *lines("")[1:]])
    )
    assert "is there a heading?" in refusal(written(tmp_path, lines("")[1:]))
    for wrong in ("0", "5-3", "two"):
        answer = here("replay", path, "--skip", wrong)
        assert (answer.code, "expected a line or lines" in answer.together) == (2, True)


def test_lines_keep_their_numbers_below_those_that_are_skipped(tmp_path: Path) -> None:
    text = ["made by a logger", "", *lines("time,t1,EZ0T")]
    text[6] = '900,"hot",1'
    skipped = Columns(layout=TextLayout(((1, 2),)))
    assert "line 7, column 't1': 'hot' is not a finite number" in refusal(written(tmp_path, text), skipped)
    assert len(read(written(tmp_path, text), Columns(layout=TextLayout(((1, 2), (7, 7))))).k) == ROWS - 1


def test_words_for_unknown_values(tmp_path: Path) -> None:
    text = lines("time,t1,EZ0T")
    for row, word in enumerate(("NaN", "---", "", "n/a", "#N/A", "null", "-"), 3):
        text[row] = f"{300 * (row - 1)},{word},{word}"
    assert np.isnan(read(written(tmp_path, text)).inputs[2:9]).all()
    text[20], text[21] = "5700,OVL,1", "6000,9999.0,1"
    path = written(tmp_path, text)
    assert "'OVL' is not a finite number; leave an unknown value empty, or --missing 'OVL'" in refusal(path)
    found = read(path, Columns(layout=TextLayout(missing=("ovl", "9999"))))
    assert np.isnan(found.inputs[19:21]).all()
    answer = here("replay", path, "--missing", "OVL", "--missing", "9999")
    assert answer.code == 0, answer.together
    assert "--missing=OVL --missing=9999" in path.with_suffix(".html").read_text("utf-8")


@pytest.mark.parametrize(
    ("heading", "unit", "step"),
    [("t [h]", "", "h"), ("Zeit (min)", "", "min"), ("time_ms", "", "ms"), ("t", "h", "h"), ("t [h]", "min", "min")],
)
def test_plain_numbers_are_in_the_unit_that_is_given_or_named(
    tmp_path: Path, heading: str, unit: str, step: str
) -> None:
    second = {"h": 1 / 3600, "min": 1 / 60, "ms": 1000}[step]
    text = lines(f"{heading},t1,EZ0T", [f"{300 * i * second:.9f}" for i in range(ROWS)])
    found = read(written(tmp_path, text), Columns(heading, clock=TimeFormat(unit=unit)))
    assert found.step_s == pytest.approx(300.0, abs=1e-3)
    assert (found.time_unit, len(found.k)) == (step, ROWS)
    assert any(note.says(NoticeCode.TIMES_IN_UNIT) for note in found.notes) is not bool(unit)


def test_an_invalid_unit_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path, lines("time,t1,EZ0T"))
    for options in (["--time-unit", "weeks"], ["--time-unit", "h", "--time-format", "excel"]):
        assert here("replay", path, *options).code == 2
    far = written(tmp_path, lines("time,t1,EZ0T", [str(1_795_525_500_000 + 300_000 * i) for i in range(ROWS)]))
    assert "are these milliseconds? --time-unit ms reads them so" in refusal(far)
    assert len(read(far, Columns(clock=TimeFormat(unit="ms"))).k) == ROWS


@pytest.mark.parametrize(
    ("form", "named"),
    [
        ("%d.%m.%Y %H:%M", "'%d.%m.%Y %H:%M' reads this one"),
        ("%m/%d/%Y %I:%M %p", "'%m/%d/%Y %I:%M %p' reads this one"),
        ("%d/%m/%Y %H:%M:%S", "'%d/%m/%Y %H:%M:%S' reads this one"),
    ],
)
def test_the_form_of_a_date_is_suggested(tmp_path: Path, form: str, named: str) -> None:
    begin = datetime(2026, 11, 24, 13, 5)  # noqa: DTZ001  # as a logger writes it
    times = [(begin + timedelta(minutes=5 * i)).strftime(form) for i in range(ROWS)]
    path = written(tmp_path, lines("time;t1;EZ0T", times, ";"))
    assert f"--time-format {named}" in refusal(path)
    assert len(read(path, Columns(clock=TimeFormat(form))).k) == ROWS
    # The twelfth month's first days could be either.
    times = [(begin + timedelta(days=12, minutes=i)).strftime(form) for i in range(ROWS)]
    either = "'%m/%d/%Y %H:%M:%S' or '%d/%m/%Y %H:%M:%S' reads this one"
    if form.startswith("%d/"):
        assert either in refusal(written(tmp_path, lines("time;t1;EZ0T", times, ";")))


@pytest.mark.parametrize(
    ("form", "last"),
    [("%d.%m.%Y %H:%M:%S", "24.11.2026 24:00:00"), ("", "2026-11-24 24:00"), ("", "2026-11-24T24:00:00")],
)
@pytest.mark.parametrize("zone", [None, ZoneInfo("Europe/Zurich")])
def test_24_00_is_the_midnight_that_ends_its_day(tmp_path: Path, form: str, last: str, zone: ZoneInfo | None) -> None:
    begin = datetime(2026, 11, 24, 22, 0)  # noqa: DTZ001  # as a logger writes it
    times = [(begin + timedelta(minutes=5 * i)).strftime(form or "%Y-%m-%d %H:%M") for i in range(ROWS)]
    columns = Columns(clock=TimeFormat(form, zone))
    plain = read(written(tmp_path, lines("time;t1;EZ0T", times, ";")), columns)
    times[24] = last
    found = read(written(tmp_path, lines("time;t1;EZ0T", times, ";")), columns)
    assert (found.k.tolist(), found.start_utc_s) == (plain.k.tolist(), plain.start_utc_s)


def test_a_day_that_ends_at_24_00_is_advised_the_form_that_reads_it(tmp_path: Path) -> None:
    begin = datetime(2026, 11, 24, 22, 0)  # noqa: DTZ001  # as a logger writes it
    times = [(begin + timedelta(minutes=5 * i)).strftime("%d.%m.%Y %H:%M:%S") for i in range(ROWS)]
    times[24] = "24.11.2026 24:00:00"
    assert "--time-format '%d.%m.%Y %H:%M:%S'" in refusal(written(tmp_path, lines("time;t1;EZ0T", times, ";")))


def test_a_form_in_use_is_not_advised_again(tmp_path: Path) -> None:
    times = [f"24.11.2026 13:{i:02}" for i in range(ROWS)]
    times[7] = "24.11.2026 25:00"
    path = written(tmp_path, lines("time;t1;EZ0T", times, ";"))
    said = refusal(path, Columns(clock=TimeFormat("%d.%m.%Y %H:%M")))
    assert "'24.11.2026 25:00' is not a time; expected a time like %d.%m.%Y %H:%M" in said
    assert "--time-format" not in said


def test_times_of_day_that_go_on_after_midnight_need_a_date_and_no_sorting(tmp_path: Path) -> None:
    times = [f"{22 + i // 12:02}:{5 * (i % 12):02}" if i < 25 else f"00:{5 * (i % 12):02}" for i in range(ROWS)]
    assert times[24] == "24:00"
    path = written(tmp_path, lines("time;t1;EZ0T", times, ";"))
    said = refusal(path, Columns(clock=TimeFormat("%H:%M")))
    assert "--time-of-day" in said
    assert "--runs" not in said


def test_a_heading_that_is_written_again_is_one_message(tmp_path: Path) -> None:
    text = lines("time,t1,EZ0T")
    text[20:20] = text[30:30] = [text[0]]
    path = written(tmp_path, text)
    assert refusal(path) == f"{path}: line 21: and 1 more repeat the heading; --skip 21,31 leaves them out"
    assert len(read(path, Columns(layout=TextLayout(((21, 21), (31, 31))))).k) == ROWS


def test_runs_whose_time_starts_again_follow_each_other(tmp_path: Path) -> None:
    text = ["time,run,t1,EZ0T", *(f"{300 * (i % 20)},{'ab'[i // 20]},{20 + i % 7},{i}" for i in range(ROWS))]
    path = written(tmp_path, text)
    assert "--runs COLUMN" in refusal(path)
    found = read(path, Columns(runs="run"))
    assert (found.input_names, found.restarts) == (("t1",), (20,))
    assert found.k.tolist() == list(range(ROWS))
    assert found.errors[:, 4].tolist() == list(range(ROWS))
    text[5] = text[5].replace("1200,", "2400,")  # within a run time may not go back
    assert "line 7" in refusal(written(tmp_path, text), Columns(runs="run"))


def test_a_learner_measures_where_a_run_begins(tmp_path: Path) -> None:
    text = ["time,run,t1,EZ0T", *(f"{300 * (i % 60)},{i // 60},{20 + 3 * (i % 60)},{6 * (i % 60)}" for i in range(180))]
    path, steps = written(tmp_path, text), tmp_path / "steps.csv"
    answer = here("replay", path, "--runs", "run", "--out", steps)
    assert answer.code == 0, answer.together
    assert "3 runs: time starts again at line 62, 122" in answer.together
    assert "--runs run" in path.with_suffix(".html").read_text("utf-8")
    with steps.open(encoding="utf-8", newline="") as file:
        used = [row["EZ0T_measured"] != "" for row in csv.DictReader(file)]
    assert any(used[60:63])
    assert any(used[120:123])


def test_dense_runs_never_share_a_step(tmp_path: Path) -> None:
    text = ["time,run,t1,EZ0T", *(f"{10 * (i % 600)},{i // 600},{i // 600},1" for i in range(1200))]
    found = read(written(tmp_path, text), Columns(runs="run"))
    assert set(found.inputs[:, 0].tolist()) == {0.0, 1.0}
    assert found.inputs[found.k == found.restarts[0], 0].tolist() == [1.0]


def test_a_date_and_a_time_of_day_in_two_columns(tmp_path: Path) -> None:
    text = ["Date;Time;t1;EZ0T", *(f"24.11.2026;{i // 12:02}:{i % 12 * 5:02};{20 + i % 3};1" for i in range(ROWS))]
    path = written(tmp_path, text)
    answer = here("replay", path, "--time", "Date", "--time-of-day", "Time", "--time-format", "%d.%m.%Y %H:%M")
    assert answer.code == 0, answer.together
    assert "inputs (1): t1\n" in answer.together
    assert "--time-of-day Time" in path.with_suffix(".html").read_text("utf-8")


def test_repeated_rows_are_left_out_and_counted(tmp_path: Path) -> None:
    text = lines("time,t1,EZ0T")
    twice = [text[0], *(line for line in text[1:] for _ in range(2))]
    found = read(written(tmp_path, twice))
    assert np.array_equal(found.inputs, read(written(tmp_path, text)).inputs)
    assert found.notes == (Text(NoticeCode.ROWS_REPEATED, n=ROWS, word="lines"),)
    twice[4] = "300,99,1"
    said = refusal(written(tmp_path, twice))
    assert "line 5, column 'time': has the time of the row before it, but other values" in said


def test_dense_rows_may_have_equal_times(tmp_path: Path) -> None:
    text = ["time,t1,EZ0T", *(f"2026-11-24T13:{i // 3:02},{i},1" for i in range(150))]
    found = read_recording(written(tmp_path, text), Columns(), 120.0)
    assert found.inputs[:2, 0].tolist() == [1.0, 5.5]  # 13:00, then 13:01 and 13:02
    assert found.notes == (Text(NoticeCode.ROWS_OF_ONE_TIME, n=100, word="lines"),)


def test_hourly_rows_repeat_an_hour_when_summer_time_ends(tmp_path: Path) -> None:
    begin = datetime(2026, 10, 24, 12, tzinfo=ZoneInfo("UTC"))
    local = [(begin + timedelta(hours=i)).astimezone(ZoneInfo("Europe/Zurich")) for i in range(ROWS)]
    path = written(tmp_path, lines("time,t1,EZ0T", [time.strftime("%Y-%m-%d %H:%M") for time in local]))
    assert "--time-zone, as in Europe/Zurich, tells the hours apart" in refusal(path)
    assert (np.diff(read(path, Columns(clock=TimeFormat(zone=ZoneInfo("Europe/Zurich")))).k) == 1).all()


def test_dense_rows_of_equal_times_stay_together_in_both_passes_of_the_hour_that_comes_twice(tmp_path: Path) -> None:
    begin = datetime(2026, 10, 25, 0, 0, 5, tzinfo=ZoneInfo("UTC"))  # 02:00:05, for the first time
    local = [(begin + timedelta(seconds=10 * (i // 2))).astimezone(ZoneInfo("Europe/Zurich")) for i in range(1440)]
    text = ["time,t1,EZ0T", *(f"{time:%Y-%m-%d %H:%M:%S},{i},1" for i, time in enumerate(local))]
    found = read(written(tmp_path, text), Columns(clock=TimeFormat(zone=ZoneInfo("Europe/Zurich"))))
    assert (np.diff(found.k) == 1).all()
    assert np.diff(found.inputs[1:-1, 0]).tolist() == [60.0] * (len(found.k) - 3)


def test_rows_out_of_order_are_not_taken_for_summer_time(tmp_path: Path) -> None:
    text = lines("time,t1,EZ0T")
    text[7], text[8] = text[8], text[7]
    said = refusal(written(tmp_path, text))
    assert "line 9, column 'time': '1800' is earlier than the time before it, '2100'" in said
    assert "summer" not in said


@pytest.mark.parametrize("name", ["lift [mm]", "lift (mm)", "lift_mm", "lift mm"])
def test_an_error_in_millimetres_by_its_name_is_not_read_as_micrometres(tmp_path: Path, name: str) -> None:
    path = written(tmp_path, lines(f"time,t1,{name}"))
    given = {"Z": name}
    assert f"column '{name}': its name says mm: --unit 'Z=mm' reads it so" in refusal(path, Columns(errors=given))
    for unit, most in (("mm", 4000.0), ("um", 4.0)):
        found = read(path, Columns(errors=given, units={"Z": unit}))
        assert np.nanmax(found.errors) == most


def test_a_column_of_text_hides_no_other_mistake(tmp_path: Path) -> None:
    text = ["time,note,t1,EZ0T", *(f"{s},ok,{20 if i < 30 else 'hot'},1" for i, s in enumerate(SECONDS))]
    said = refusal(written(tmp_path, text))
    assert said.count("column 'note'") == 3
    assert "'hot' is not a finite number" in said
    assert "--ignore 'note' leaves the column out" in said


def test_inputs_that_say_nothing_are_named(tmp_path: Path) -> None:
    text = ["time,t1,fan,open,EZ0T", *(f"{s},{20 + i % 3},1,,{i % 5}" for i, s in enumerate(SECONDS))]
    answer = here("replay", written(tmp_path, text))
    assert "inputs without any change, or without a value: fan, open\n" in answer.together


def test_parquet_has_no_lines_to_skip(tmp_path: Path) -> None:
    path = tmp_path / "lab.parquet"
    pyarrow.parquet.write_table(pyarrow.table({"time": [1.0], "t1": [1.0], "EZ0T": [1.0]}), path)
    assert "Parquet" in refusal(path, Columns(layout=TextLayout(((1, 1),))))
