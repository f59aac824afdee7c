"""A new reference: the level begins again at zero, and what was learnt of the inputs stays."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from talc.control import Controller
from talc.estimators.learner import Learner
from talc.frame import Decision, EventCode, EventKind, Frame, Measurement
from talc.learner.experts import UNIT, Expert
from talc.learner.mixture import Mixture
from talc.learner.process import MOST_ROWS, OTHER_REFERENCE, Rows
from talc.settings import TalcSettings
from talc.snapshot import from_plain, to_plain
from tests.benches.thermal_series import ThermalSeries, series

Array = NDArray[np.float64]
INPUTS, LAGS, NOISE = 3, 2, 0.7
FEATURES = INPUTS * LAGS


def walk(count: int, seed: int) -> Array:
    return np.cumsum(np.random.default_rng(seed).normal(size=(count, FEATURES)), axis=0) * 0.3


def learnt(mixture: Mixture, x: Array, y: Array) -> None:
    for row, value in zip(x, y, strict=True):
        errors = np.full(9, np.nan)
        errors[0] = value
        mixture.learn(row, errors, np.full(9, NOISE), np.zeros(9))
        mixture.elapse(3)


@pytest.mark.parametrize("expert", [Expert(1.0, 0.01), Expert(2.0, 0.02, smooth=1.5, misfit=0.05)])
def test_rows_of_two_references_share_their_weights_and_nothing_else(expert: Expert) -> None:
    """Against one dense normal distribution, in which levels and references of the two are independent."""
    many, draw = 30, np.random.default_rng(3)
    x = np.concatenate([(one := walk(many, 0)) - one[0], (other := walk(many, 1)) - other[0]])
    y = x[:, 0] * 3.0 - x[:, 4] + draw.normal(0, NOISE, 2 * many)
    y[:many] += 4.0
    mixture = Mixture(INPUTS, LAGS, 300.0, (expert,))
    learnt(mixture, x[:many], y[:many])
    mixture.new_reference()
    learnt(mixture, x[many:], y[many:])
    at = walk(1, 5)[0] * 4.0
    mean, variance = mixture.predict(at)

    own = np.repeat([0, 1], many)
    time = np.tile(3.0 * np.arange(many), 2)
    zero = np.zeros((1, FEATURES))

    def of_inputs(a: Array, b: Array) -> Array:
        def smooth(one: Array, two: Array) -> Array:
            apart = np.sum((one[:, None] - two[None]) ** 2, axis=2)
            return np.asarray((expert.smooth * UNIT) ** 2 * np.exp(-apart / (2 * FEATURES)))

        found = (expert.linear * UNIT) ** 2 / FEATURES * a @ b.T + smooth(a, b)
        return found - (smooth(a, zero) @ smooth(zero, b) / smooth(zero, zero) if expert.smooth else 0.0)

    same = own[:, None] == own[None]
    level = (expert.level * UNIT) ** 2
    among = of_inputs(x, x) + same * (level * np.minimum(time[:, None], time[None]) + 0.2 * NOISE**2)
    # The first measurement begins the first level, 4 µm off, unless it is within its noise.
    first = float(y[0] ** 2) if abs(y[0]) > 4.0 * NOISE else 0.0
    among += np.where((own[:, None] == 0) & (own[None] == 0), first, 0.0)
    among += (NOISE**2 + (expert.misfit * UNIT) ** 2) * np.eye(2 * many)
    # The level of the second is the mean of what it measures there: its reference's noise counts as a level.
    across = of_inputs(x, at[None])[:, 0] + (own == 1) * (level * time + 0.2 * NOISE**2)
    alone = of_inputs(at[None], at[None])[0, 0] + level * 3.0 * many + 0.2 * NOISE**2
    factor = cho_factor(among)
    assert mean[0] == pytest.approx(0.997 * across @ cho_solve(factor, y), rel=0.02, abs=0.02)
    assert variance[0] == pytest.approx(
        alone - across @ cho_solve(factor, across) + (expert.misfit * UNIT) ** 2, rel=0.02
    )


SIGMA = np.full(9, 0.5)
SETTINGS = TalcSettings(method="learner")
AT, ROWS = 400, 576


@pytest.fixture(scope="module")
def days() -> ThermalSeries:
    """Two days."""
    return series(ROWS, 3)


def frame(days: ThermalSeries, k: int, zero: Array, *, measured: bool, new_reference: bool = False) -> Frame:
    measurement = Measurement(days.measured[k] - zero, SIGMA) if measured else None
    return Frame(k, days.inputs[k], ALL_12, measurement, new_reference=new_reference)


ALL_12 = np.ones(12, dtype=np.bool_)


def clamped_again(days: ThermalSeries, at: int | None, told: bool) -> tuple[list[Decision], Array]:
    """Measured each hour; from `at` on errors count from that row. Decisions, and predictions minus the truth."""
    controller = Controller(days.names, SETTINGS)
    decisions, off, zero = [], np.zeros((ROWS, 9)), days.truth[0]
    for k in range(ROWS):
        if k == at:
            zero = days.truth[k]
        decision = controller.step(frame(days, k, zero, measured=k % 12 == 0, new_reference=told and k == at))
        decisions.append(decision)
        off[k] = np.nan_to_num(decision.predicted) - (days.truth[k] - zero)
    return decisions, off


def outliers(decisions: list[Decision]) -> int:
    return sum(event.code == EventCode.OUTLIER for decision in decisions for event in decision.events)


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


@pytest.mark.slow
@pytest.mark.parametrize("at", [AT, AT + 8], ids=["measured there", "measured later"])
def test_after_a_new_reference_the_errors_are_predicted_as_before_it(days: ThermalSeries, at: int) -> None:
    _, unbroken = clamped_again(days, None, told=False)
    decisions, off = clamped_again(days, at, told=True)
    _, untold = clamped_again(days, at, told=False)
    assert outliers(decisions[at : at + 24]) == 0
    assert [e.code for e in decisions[at].events if e.kind is EventKind.NEW_REFERENCE] == [EventCode.NEW_REFERENCE]
    assert np.abs(decisions[at].corrected).max() < 1.0
    assert rms(off[at:]) < 1.1 * rms(unbroken[at:])
    assert rms(off[at : at + 24]) < 0.5 * rms(untold[at : at + 24])


def test_a_restart_after_a_new_reference_decides_as_no_restart(days: ThermalSeries) -> None:
    whole = Controller(days.names, SETTINGS)
    for k in range(260):
        whole.step(frame(days, k, days.truth[0], measured=k % 12 == 0, new_reference=k == 250))
    again = Controller.restore(whole.state(), SETTINGS)
    for k in range(260, 330):
        a, b = (
            c.step(frame(days, k, days.truth[250], measured=k % 6 == 0, new_reference=k == 300)) for c in (whole, again)
        )
        for name in ("predicted", "corrected", "sigma", "trusted"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


def test_a_state_without_an_origin_counts_from_its_only_reference(days: ThermalSeries) -> None:
    """As an earlier program has written it."""
    whole = Controller(days.names, SETTINGS)
    for k in range(30):
        whole.step(frame(days, k, days.truth[0], measured=k % 12 == 0))
    plain, arrays = to_plain(whole.state().without_record())
    del arrays["learner.origin"], plain["mixture"]["references"]
    for name in ("before", "former_jolted", "former_last", "former_evidence", "former_zero", "refused"):
        del arrays[f"mixture.{name}"]
    again = Controller.restore(from_plain(plain, arrays, lambda *_: pytest.fail("no frames")), SETTINGS)
    expected = whole.step(frame(days, 30, days.truth[0], measured=True))
    np.testing.assert_array_equal(again.step(frame(days, 30, days.truth[0], measured=True)).sigma, expected.sigma)


def test_a_reference_before_any_measurement_is_the_first_one(days: ThermalSeries) -> None:
    plain, told = Controller(days.names, SETTINGS), Controller(days.names, SETTINGS)
    for k in range(24):
        a, b = (
            c.step(frame(days, k, days.truth[0], measured=k >= 3, new_reference=c is told and k < 4))
            for c in (plain, told)
        )
    np.testing.assert_array_equal(a.corrected, b.corrected)


def test_measurements_of_two_references_are_not_averaged() -> None:
    rows, draw = Rows(FEATURES, 1), np.random.default_rng(0)
    for i in range(MOST_ROWS):
        jolt = np.full(1, OTHER_REFERENCE if i >= 100 else 0.0)
        rows.append(draw.normal(size=FEATURES), float(i), jolt, np.full(1, 100.0 if i >= 100 else 0.0), np.ones(1))
    rows.thin()
    assert set(rows.y[: rows.n, 0].tolist()) == {0.0, 100.0}


def test_models_know_one_reference(days: ThermalSeries) -> None:
    controller = Controller(days.names, TalcSettings(method="models"))
    with pytest.raises(ValueError, match="reference"):
        controller.step(frame(days, 0, days.truth[0], measured=True, new_reference=True))


def test_the_library_goes_on_with_the_next_run(days: ThermalSeries) -> None:
    half, every = ROWS // 2, np.arange(ROWS) % 12 == 0
    y = np.where(every[:, None], days.measured, np.nan)
    begun = Learner(noise=0.5).fit(days.inputs[:half], y[:half] - days.truth[0])
    zero = days.truth[half - 1]
    found = begun.new_reference().predict(days.inputs[half:])
    left, before = rms(found[:48] - (days.truth - zero)[half : half + 48]), rms((days.truth - zero)[half : half + 48])
    assert left < 0.5 * before
