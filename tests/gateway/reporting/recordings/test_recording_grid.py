"""A recording's rows are late and early, drift and pause; each reaches the step that it belongs to."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from gateway.control.replay.recorded import rehearse_recording
from gateway.reporting.recordings.columns import Columns
from gateway.reporting.recordings.grid import Recording, read_recording
from talc.frame import Phase
from talc.settings import ControlSettings, TalcSettings
from tests.benches.thermal_series import series


def read(folder: Path, times: Sequence[float], step_s: float = 300.0) -> Recording:
    """Read rows whose input is the row's number."""
    path = folder / "some.csv"
    rows = [f"{at!r},{i},{i}" for i, at in enumerate(times)]
    path.write_text("\n".join(["time,t1,EX0C", *rows]), encoding="utf-8")
    return read_recording(path, Columns(), step_s)


def test_jitter_about_the_grid_leaves_no_gap(tmp_path: Path) -> None:
    late = np.random.default_rng(1).uniform(-3.0, 3.0, 400)
    for phase in (0.0, 149.0, 151.0, 299.0):
        recording = read(tmp_path, (300.0 * np.arange(1, 401) + phase + late).tolist())
        assert recording.step_s == 300.0
        assert (np.diff(recording.k) == 1).all()
        assert recording.inputs[:, 0].tolist() == list(range(400))
        assert recording.start_utc_s == 300.0 + phase + late[0]


def test_a_clock_that_drifts_past_the_grid_leaves_no_gap(tmp_path: Path) -> None:
    late = np.random.default_rng(2).uniform(-5.0, 5.0, 900)
    recording = read(tmp_path, (300.6 * np.arange(900) + late).tolist())  # 540 s late at the end
    assert (np.diff(recording.k) == 1).all()


def test_missing_rows_stay_gaps_under_jitter(tmp_path: Path) -> None:
    late = np.random.default_rng(3).uniform(-20.0, 20.0, 100)
    kept = np.array([i for i in range(100) if i not in (40, 70, 71, 72)])
    recording = read(tmp_path, (300.0 * kept + late[kept]).tolist())
    assert (recording.k - recording.k[0]).tolist() == kept.tolist()


@pytest.mark.parametrize(("spacing_s", "step_s"), [(200.0, 300.0), (280.0, 280.0), (301.0, 300.0), (420.0, 420.0)])
def test_the_step_is_the_grids_unless_rows_come_about_that_far_apart(
    tmp_path: Path, spacing_s: float, step_s: float
) -> None:
    assert read(tmp_path, (spacing_s * np.arange(60)).tolist()).step_s == step_s


def test_a_recording_with_jitter_finds_its_models(tmp_path: Path) -> None:
    made = series(200, 4, sensors=12)
    late = np.random.default_rng(4).uniform(-3.0, 3.0, 200)
    path = tmp_path / "jitter.csv"
    rows = [
        ",".join(str(v) for v in (300.0 * i + late[i], *made.inputs[i], made.measured[i, 2])) for i in range(1, 200)
    ]
    path.write_text("\n".join([",".join(["time", *made.names, "EX0C"]), *rows]), encoding="utf-8")
    settings = TalcSettings(method="models", control=ControlSettings(calibration_steps=144))
    data = rehearse_recording(read_recording(path, Columns(), 300.0), settings)
    assert data.phases[-1] is Phase.COMPENSATION
    assert data.models[0].models.models[2] is not None
