"""A recording of runs whose errors count from their own beginnings: one learner learns from all of them."""

import csv
from pathlib import Path

import numpy as np
import pytest

from gateway.config.problems import ConfigError
from gateway.control.replay.run import Request, run_recording
from gateway.reporting.recordings.columns import Columns

ROWS = 48


def runs(path: Path) -> Path:
    """Four runs, each clamped some 40 µm off the others; the error follows a lag of the first temperature."""
    draw, lines = np.random.default_rng(0), ["run,time,t1,t2,EZ0A"]
    for run in range(4):
        heat, lag, off = np.cumsum(draw.normal(0.06, 0.06, ROWS)), 0.0, draw.normal(0.0, 40.0)
        for i in range(ROWS):
            lag += 0.1 * (heat[i] - lag)
            error = 5.0 * lag + off + draw.normal(0.0, 0.1)
            lines.append(f"{run},{i * 300},{20 + heat[i]:.2f},{20 + lag:.2f},{error:.2f}")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def request(folder: Path, **more: object) -> Request:
    columns = Columns(runs="run")
    given = {"config": None, "every_measurement": False, "out": folder / "steps.csv", "zero_each_run": True} | more
    return Request(runs(folder / "runs.csv"), columns, folder / "page.html", **given)  # type: ignore[arg-type]


def test_each_run_begins_at_zero_and_is_predicted_by_the_runs_before_it(tmp_path: Path) -> None:
    run_recording(request(tmp_path))
    with (tmp_path / "steps.csv").open(encoding="utf-8") as file:
        steps = list(csv.DictReader(file))
    recorded, predicted = (
        np.array([float(row[name] or "nan") for row in steps]) for name in ("EZ0A", "EZ0A_predicted")
    )
    begins = np.arange(4) * ROWS
    assert recorded[begins].tolist() == [0.0] * 4
    assert np.abs(predicted[begins[1:]]).max() < 0.5
    last = slice(3 * ROWS, None)
    assert np.sqrt(np.mean((predicted - recorded)[last] ** 2)) < 0.2 * np.sqrt(np.mean(recorded[last] ** 2))


def test_trained_models_are_refused(tmp_path: Path) -> None:
    config = tmp_path / "models.toml"
    config.write_text('[talc]\nmethod = "models"\n', encoding="utf-8")
    with pytest.raises(ConfigError, match="--zero-each-run"):
        run_recording(request(tmp_path, config=config))
