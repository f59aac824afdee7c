"""What could remain at the demo's tool: what is sent instead of the estimates, and the table."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.demo import DemoLoop
from benchmarks.demo_bounds import KNOWN, WAYS, bounds_table, known
from gateway.reporting.data import ReportData
from gateway.reporting.figures import summary
from talc.frame import FloatArray, Frame

HOURS = 3.0


@pytest.fixture(scope="module")
def loop() -> tuple[ReportData, tuple[Frame, ...]]:
    one = DemoLoop(1, HOURS)
    return one.run(), tuple(one.frames)


@pytest.fixture(scope="module")
def sent(loop: tuple[ReportData, tuple[Frame, ...]]) -> list[FloatArray]:
    return known(*loop)


@pytest.mark.slow
def test_what_is_sent_is_the_truth_as_far_as_each_way_knows_it(
    loop: tuple[ReportData, tuple[Frame, ...]], sent: list[FloatArray]
) -> None:
    data, _ = loop
    assert data.truth is not None
    truth = np.array([data.truth.errors[data.truth.time_s == at][0] for at in data.time_s])
    seen = np.flatnonzero(np.isfinite(data.measured).all(axis=1))
    first, second = seen[:2]
    assert second - first >= 2, "a row in between"
    exact, between, held, weighed = sent
    assert len(sent) == len(KNOWN)
    for way in sent:
        assert np.isnan(way[:first]).all()
        assert np.isfinite(way[first:]).all()
    np.testing.assert_array_equal(exact[first:], truth[first:])
    np.testing.assert_array_equal(between[seen], truth[seen])
    np.testing.assert_allclose(np.diff(between[first : second + 1], n=2, axis=0), 0.0, atol=1e-9)
    np.testing.assert_array_equal(held[first:second], np.repeat(truth[first : first + 1], second - first, axis=0))
    np.testing.assert_array_equal(held[second], truth[second])
    left = np.sum((truth - weighed)[first:] ** 2, axis=0)
    assert (left <= np.sum(truth[first:] ** 2, axis=0) * (1.0 + 1e-9)).all(), "at worst all weights are 0"
    estimate = np.nan_to_num(data.corrected)
    large = 1  # EZ0A, the largest of the nine
    assert left[large] < np.sum((truth - estimate)[first:, large] ** 2)


@pytest.mark.slow
def test_the_control_gets_what_is_sent_and_the_learner_measures_as_before(
    loop: tuple[ReportData, tuple[Frame, ...]], sent: list[FloatArray]
) -> None:
    data, _ = loop
    nothing = DemoLoop(1, HOURS, sent=np.zeros((round(HOURS * 12), 9))).run()
    exact = DemoLoop(1, HOURS, sent=sent[0]).run()
    np.testing.assert_array_equal(np.isfinite(exact.measured), np.isfinite(data.measured))
    for row in summary(nothing).tool:
        assert row.compensated_e_rms == row.e_rms
    learner = {row.name: row.compensated_e_rms for row in summary(data).tool}
    for row in summary(exact).tool:
        assert row.compensated_e_rms < min(0.3 * row.e_rms, learner[row.name])


def test_the_table_shows_shares_that_are_left_and_counts_peaks(loop: tuple[ReportData, tuple[Frame, ...]]) -> None:
    one = summary(loop[0])
    half = tuple(replace(row, e_rms=8.0, compensated_e_rms=4.0, e_pv=9.0, compensated_e_pv=8.0) for row in one.tool)
    worse = (*half[:2], replace(half[2], compensated_e_rms=2.0, compensated_e_pv=10.0))
    rows = list(bounds_table([[(half, 30)] * len(WAYS), [(worse, 32)] * len(WAYS)]))
    assert len(rows) == len(WAYS)
    assert rows[0].ours == "50 (50 to 50); 50 (50 to 50); 38 (25 to 50)"
    assert rows[0].peer == "E_PV above that without in 0, 0, 1 of 2 seeds; 31 (30 to 32) measurements"
