"""Roles of columns: stated once, found by name, and no error is ever among the inputs."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gateway.reporting.recordings.columns import Columns
from gateway.reporting.recordings.grid import Recording, read_recording
from gateway.reporting.recordings.problems import RecordingError
from tests.benches.command import here


def table(folder: Path, *names: str) -> Path:
    path = folder / "own.csv"
    rows = [",".join([str(300 * i), *(str(20 + i % (3 + c)) for c in range(len(names) - 1))]) for i in range(1, 30)]
    path.write_text("\n".join([",".join(names), *rows]), encoding="utf-8")
    return path


def read(path: Path, columns: Columns) -> Recording:
    return read_recording(path, columns, 300.0)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("EX0C_um", "looks like EX0C, which is column 'EX0C' already; --ignore 'EX0C_um' leaves it out"),
        ("ex0c", "looks like EX0C, which is column 'EX0C' already"),
        ("true EX0C", "looks like EX0C, which is column 'EX0C' already"),
        (
            "EZ0T_mm",
            "looks like a thermal error; did you mean 'EZ0T'? --error 'EZ0T=EZ0T_mm' takes it as EZ0T in mm (with "
            "--unit EZ0T=mm)",
        ),
        ("ey0a", "looks like a thermal error; did you mean 'EY0A'? --error 'EY0A=ey0a' takes it as EY0A in µm"),
        ("EYOA (µm)", "looks like a thermal error; did you mean 'EY0A'?"),
        ("EX0B", "looks like an error, and errors are not inputs; --ignore 'EX0B' leaves it out, or rename it"),
    ],
)
def test_what_looks_like_an_error_is_no_input(tmp_path: Path, name: str, message: str) -> None:
    path = table(tmp_path, "time", "t1", "EX0C", name)
    with pytest.raises(RecordingError) as refused:
        read(path, Columns())
    assert f"column '{name}': {message}" in str(refused.value)
    assert read(path, Columns(ignored=(name,))).input_names == ("t1",)


def test_a_misspelt_error_is_suggested_and_can_be_named(tmp_path: Path) -> None:
    path = table(tmp_path, "time", "t1", "ex0c")
    answer = here("replay", path)
    assert answer.code == 2
    assert "column 'ex0c': looks like a thermal error; did you mean 'EX0C'?" in answer.together
    assert here("replay", path, "--error", "EX0C=ex0c").code == 0


def test_inputs_of_other_names_stay_inputs(tmp_path: Path) -> None:
    names = ("growth_um", "E0", "exocooler", "Ext temp", "A0C", "bed")
    assert read(table(tmp_path, "time", "EX0C", *names), Columns()).input_names == names


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--error", "EX0C=t1", "--error", "EY0A=t1"], "column 't1': has two roles, EX0C and EY0A; give it one"),
        (["--error", "EY0A=time"], "column 'time': has two roles, the time and EY0A"),
        (["--ignore", "EX0C", "--error", "EX0C=EX0C"], "column 'EX0C': has two roles, EX0C and left out by --ignore"),
        (["--ignore", "time"], "column 'time': has two roles, the time and left out by --ignore"),
        (["--error", "EX0C=t1"], "column 'EX0C': looks like EX0C, which is column 't1' already; --ignore 'EX0C'"),
        (["--error", "EX0C=t1", "--error", "EX0C=t2"], "EX0C is given twice: 't1' and 't2'"),
        (["--time", "EX0C"], "no column of a thermal error"),
    ],
)
def test_what_contradicts_itself_is_refused(tmp_path: Path, options: list[str], message: str) -> None:
    answer = here("replay", table(tmp_path, "time", "t1", "t2", "EX0C"), *options)
    assert answer.code == 2
    assert message in answer.together


def test_the_row_numbers_of_pandas_are_not_an_input(tmp_path: Path) -> None:
    path = tmp_path / "indexed.csv"
    rows = [f"{i},{300 * i},{20 + i % 3},{i}" for i in range(1, 30)]
    path.write_text("\n".join([",time,t1,EX0C", *rows]), encoding="utf-8")
    found = read(path, Columns())
    assert (found.input_names, found.ignored) == (("t1",), ("",))
    with pytest.raises(RecordingError, match='column 1 has no name: if it is the time, give --time ""; otherwise'):
        read(table(tmp_path, "", "t1", "EX0C"), Columns())
    assert here("replay", table(tmp_path, "", "t1", "EX0C"), "--time", "").code == 0


def test_the_index_of_pandas_in_parquet_is_the_time_or_no_input(tmp_path: Path) -> None:
    path = tmp_path / "indexed.parquet"
    index = pd.date_range("2026-03-02", periods=60, freq="5min")
    frame = pd.DataFrame({"t1": np.arange(60) % 3, "EX0C": np.arange(60.0)}, index=index)
    frame.to_parquet(path)
    answer = here("replay", path)
    assert answer.code == 2
    assert "column '__index_level_0__' is an index of pandas: if it is the time, give --time __index" in answer.together
    assert read(path, Columns("__index_level_0__")).input_names == ("t1",)
    frame.rename_axis("time").reset_index()[frame["t1"].to_numpy() > 0].to_parquet(path)
    found = read(path, Columns())
    assert (found.input_names, found.ignored) == (("t1",), ("__index_level_0__",))
    assert read(path, Columns(inputs=("__index_level_0__",))).input_names == ("t1", "__index_level_0__")


def test_a_column_given_as_an_error_of_another_name_is_that_error_alone(tmp_path: Path) -> None:
    found = read(table(tmp_path, "time", "t1", "EZ0T", "EX0C"), Columns(errors={"drift": "EZ0T"}))
    assert dict(found.error_columns) == {"drift": "EZ0T", "EX0C": "EX0C"}
    assert found.input_names == ("t1",)


def test_a_column_given_as_an_input_is_no_error_by_its_name(tmp_path: Path) -> None:
    path = table(tmp_path, "time", "t1", "EX0C", "EZ0T")
    found = read(path, Columns(inputs=("EX0C",)))
    assert dict(found.error_columns) == {"EZ0T": "EZ0T"}
    assert found.input_names == ("t1", "EX0C")
    assert "errors: EZ0T\ninputs (2): t1, EX0C\n" in here("replay", path, "--input", "EX0C").together
