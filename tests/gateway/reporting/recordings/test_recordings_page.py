"""The command of docs/recordings.md, and the figures below it."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from gateway.cli.main import main

ROOT = Path(__file__).parents[4]


@pytest.mark.slow
def test_the_recording_that_comes_with_the_sources_gives_the_figures_of_the_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = (ROOT / "docs" / "recordings.md").read_text("utf-8")
    command = next(line for line in page.splitlines() if line.startswith("talc-gateway replay benchmarks/"))
    words = [str(ROOT / word) if word.startswith("benchmarks/") else word for word in shlex.split(command)[1:]]
    monkeypatch.chdir(tmp_path)
    answer = CliRunner().invoke(main, words, catch_exceptions=False)
    assert answer.exit_code == 0, answer.output
    assert {file.name for file in tmp_path.iterdir()} == {"spindle.html", "spindle.csv", "spindle-models.csv"}
    told = re.search(
        r"With (\d+) measurements it leaves ([\d.]+) of ([\d.]+) µm RMS; holding .* leave ([\d.]+)\.", page
    )
    assert told is not None
    measurements, left, none, held = (float(number) for number in told.groups())
    found = np.genfromtxt(tmp_path / "spindle.csv", delimiter=",", names=True, encoding="utf-8", dtype=None)
    error, used = found["spindle_Z"], np.isfinite(found["spindle_Z_measured"])
    rows = np.arange(len(error))
    last = np.maximum.accumulate(np.where(used, rows, 0))[:-1]
    assert used.sum() == measurements
    assert np.sqrt(np.mean(error**2)) == pytest.approx(none, abs=0.1)
    assert np.sqrt(np.mean((error - np.nan_to_num(found["spindle_Z_predicted"])) ** 2)) == pytest.approx(left, abs=0.15)
    assert np.sqrt(np.mean((error[1:] - error[last]) ** 2)) == pytest.approx(held, abs=0.1)
