"""Trained models beside the learner: the hours that are judged, and the table."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.demo import DemoLoop
from benchmarks.demo_models import NAMES, LaterHours, later, later_table
from gateway.reporting.data import Truth
from talc.control import Controller
from talc.frame import Phase
from talc.settings import TalcSettings
from tests.benches.small_run import STEP_S, small_run

HOUR_S = 3600.0


def test_only_later_hours_are_judged_and_probing_only_for_the_errors() -> None:
    run = small_run(24)
    times = np.asarray(np.arange(24) * STEP_S, dtype=np.float64)
    errors = np.zeros((24, 9))
    errors[:, 0] = np.where(times < HOUR_S, 100.0, 6.0)
    tool = np.where(times[:, None] < HOUR_S, 50.0, 8.0) * np.ones(3)
    probing = times >= 1.5 * HOUR_S
    tool[probing] = 70.0
    corrected = np.full((24, 9), np.nan)  # no model: nothing is corrected
    corrected[:, 0] = 4.0
    truth = Truth(times, errors, tool, tool / 2.0, probing)
    measured = np.full((24, 9), np.nan)
    measured[:5] = 0.0
    found = later(replace(run, truth=truth, corrected=corrected, measured=measured), HOUR_S)
    assert found.without == pytest.approx((6.0, *[0.0] * 8, 8.0, 8.0, 8.0))
    assert found.left == pytest.approx((2.0, *[0.0] * 8, 4.0, 4.0, 4.0))
    assert found.measurements == 5


def test_the_table_counts_the_seeds_on_which_models_leave_less() -> None:
    def seeds(*left: float) -> list[LaterHours]:
        return [LaterHours((9.0,) * 12, (each,) * 12, 40) for each in left]

    rows = list(later_table(seeds(1.0, 2.0, 3.0), seeds(2.0, 1.0, 2.0)))
    assert [row.work.split(",")[0] for row in rows[:-1]] == list(NAMES)
    assert rows[0].ours == "2.00 (1.00 to 3.00) learner"
    assert rows[0].peer == "2.00 (1.00 to 2.00) models; less in 2 of 3; 9.00 (9.00 to 9.00) without"
    assert (rows[-1].ours, rows[-1].peer) == ("40 (40 to 40)", "40 (40 to 40) models")


@pytest.mark.slow
def test_models_are_trained_and_adopted_at_the_end_of_the_calibration(monkeypatch: pytest.MonkeyPatch) -> None:
    adopted = []
    adopt = Controller.adopt
    monkeypatch.setattr(Controller, "adopt", lambda controller, models: adopted.append(adopt(controller, models)))
    run = DemoLoop(1, 26.0, TalcSettings(method="models")).run()
    assert adopted
    began = run.judged_from
    assert began is not None
    assert 24.0 <= run.time_s[began] / HOUR_S <= 24.5
    assert run.phases[0] is Phase.CALIBRATION
    assert np.isfinite(run.measured[:began]).all(axis=1).mean() > 0.9
