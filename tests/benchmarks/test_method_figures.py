"""The figures of docs/method.md, and the numbers beside them."""

import re
from pathlib import Path

import numpy as np
import pytest

from benchmarks import method_figures
from talc.indicators import TWO_SIDED_95, rms

ROOT = Path(__file__).parents[2]
PAGE = " ".join((ROOT / "docs" / "method.md").read_text("utf-8").split())
RESULTS = (ROOT / "docs" / "results.md").read_text("utf-8")


@pytest.mark.slow
def test_the_page_says_what_the_figures_show(tmp_path: Path) -> None:
    method_figures.main(tmp_path)
    for name in ("method-day.svg", "method-inputs.svg"):
        assert (tmp_path / name).stat().st_size > 10_000
        assert f"]({name})" in (ROOT / "docs" / "method.md").read_text("utf-8")
    table = np.loadtxt(ROOT / "benchmarks" / "recordings" / "fl_thermal" / "fl_thermal.csv", delimiter=",", skiprows=1)
    error = table[:, 20]
    mean, std, parts = method_figures.predicted_before(table[:, 1:18], error)
    np.testing.assert_allclose(parts.sum(axis=1), mean, atol=1e-9)
    held = error[(np.arange(len(error)) - 1) // 24 * 24]
    said = re.search(
        r"has an error of ([\d.]+) µm RMS\. Holding the last measurement leaves ([\d.]+) µm, "
        r"no correction ([\d.]+) µm\. "
        r"The interval contains (\d+) % of the recorded values",
        PAGE,
    )
    assert said is not None
    left = (rms(error - mean), rms((error - held)[1:]), rms(error))
    assert [float(text) for text in said.groups()[:3]] == pytest.approx(left, abs=0.051)
    within = 100.0 * np.mean(np.abs(error - mean)[1:] < TWO_SIDED_95 * std[1:])
    assert float(said[4]) == pytest.approx(within, abs=0.51)


def columns(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip("|\n").split("|")]


@pytest.mark.parametrize(
    ("method", "results"),
    [
        ("measured every hour from the start", "at once, then each 60 min"),
        ("every 4 h from the start", "at once, then each 240 min"),
        ("every step for 12 h, then every 2 h", "12 h dense, then each 120 min"),
        ("every step for 24 h, then every hour", "24 h dense, then each 60 min"),
        ("every step for 24 h, then every 4 h", "24 h dense, then each 240 min"),
    ],
)
def test_the_table_of_alternatives_repeats_the_results(method: str, results: str) -> None:
    lines = (ROOT / "docs" / "method.md").read_text("utf-8").splitlines()
    head, row = (
        columns(next(line for line in lines if line.startswith(begin)))
        for begin in ("| FL_THERMAL, RMSE µm |", f"| {method} |")
    )
    row_of = rf"(?m)^\| FL_THERMAL, read in µm, {results} \(\d+ measurements\): RMSE µm of (learner \|.*)$"
    (found,) = re.findall(row_of, RESULTS)
    learner, beside = found.removeprefix("learner | ").split(":")[0], columns(found)[2]
    figures = {"learner": float(learner)} | {
        name.strip("` "): float(value) for name, value in re.findall(r"([^\d]+?) ([\d.]+)(?:, |$)", beside)
    }
    del figures["ridge, best in hindsight"]  # no method: the page leaves it out
    said = {name.strip("`"): float(text) for name, text in zip(head[1:], row[1:], strict=True) if text != "–"}
    assert said == pytest.approx(figures, rel=0.005)
