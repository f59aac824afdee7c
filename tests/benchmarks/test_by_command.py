"""`python -m benchmarks SUBJECT`, which `make bench` runs, with few machines and few hours.

It makes the rows that docs/figures.md shows, and renews only that table.
"""

import re
from pathlib import Path

import numpy as np
import pytest

from benchmarks.__main__ import main

pytestmark = pytest.mark.slow


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
