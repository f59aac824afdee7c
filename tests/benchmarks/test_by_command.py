"""`python -m benchmarks SUBJECT`, which `make bench` runs, with few machines and few hours.

It makes the rows that docs/results.md shows, and renews only that table.
"""

import importlib
import re
from pathlib import Path

import numpy as np
import pytest

from benchmarks.__main__ import main

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
TWO = (("day", 0), ("axes", 1))
SMALL: dict[str, dict[str, object]] = {
    "demo": {"SEEDS": (1,), "HOURS": 4.0},
    "forecast": {"MACHINES": TWO, "HOURS": 36},
    "policy": {"MACHINES": TWO[:1], "FEW": TWO[1:], "HOURS": 24, "FEW_HOURS": 24, "FIXED_MIN": (60.0, 240.0)},
}
"""What is made smaller in a subject's module; the others take too long even then."""


def table(page: str, subject: str) -> str:
    return page.partition(f"<!-- benchmark {subject} -->\n")[2].partition("<!-- end -->")[0]


def work(rows: str) -> list[str]:
    """First cells, without the numbers of machines."""
    return [re.sub(r"\d+(\.\d+)?", "N", line.split("|")[1]) for line in rows.splitlines()]


@pytest.mark.parametrize("subject", SMALL)
def test_it_makes_the_rows_of_the_page_and_renews_them(
    subject: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = importlib.import_module(f"benchmarks.{subject}")
    for name, value in SMALL[subject].items():
        assert hasattr(module, name)
        monkeypatch.setattr(module, name, value)
    before = (ROOT / "docs" / "results.md").read_text("utf-8")
    page = tmp_path / "results.md"
    page.write_text(before, encoding="utf-8")
    main([subject], page)
    after = page.read_text("utf-8")
    assert work(table(after, subject)) == work(table(before, subject))
    assert table(after, subject) != table(before, subject)
    assert after.replace(table(after, subject), table(before, subject)) == before


def test_a_folder_of_own_recordings_gets_a_page_and_leaves_the_results(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    hours = np.arange(300) / 12.0
    heat = 25.0 + 5.0 * np.sin(hours)
    rows = np.column_stack([hours * 3600.0, heat, 3.0 * (heat - 25.0)])
    (tmp_path / "folder").mkdir()
    np.savetxt(tmp_path / "folder" / "mill.csv", rows, delimiter=",", header="time,heat,dz", comments="")
    (tmp_path / "folder" / "mill.toml").write_text(
        'errors = ["dz"]\ntime.unit = "s"\nintervals_min = [60]\nbeginnings_h = [0]\n', encoding="utf-8"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("RECORDINGS", "folder")
    monkeypatch.setenv("METHODS", "hold,learner")
    page = tmp_path / "results.md"
    page.write_text("<!-- benchmark recordings -->\n<!-- end -->", encoding="utf-8")
    main(["recordings"], page)
    (row,) = [line for line in capsys.readouterr().out.splitlines() if "RMSE µm of learner" in line]
    found = re.search(r"of learner \| [\d.]+: ([\d.]+) of hold", row)
    assert found is not None, row
    assert "mill, read in µm, at once" in row
    assert float(found[1]) < 0.5
    assert sorted(file.name for file in (tmp_path / "out" / "recordings").iterdir()) == ["mill.json", "mill.md"]
    assert page.read_text("utf-8") == "<!-- benchmark recordings -->\n<!-- end -->", "figures of a user's own data"
