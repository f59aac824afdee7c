"""A chip on the sphere must not become a model, but a machine that really changed must be accepted."""

import math

import numpy as np
import pytest

from gateway.config.sections import Probing
from gateway.nc.probing.checks import Expected, MeasurementChecks
from gateway.nc.probing.cycle import Probe, Rejected, poses_in_radians
from talc.frame import FloatArray, Measurement
from talc.probing import ProbingResult, design_matrix

POSES = poses_in_radians(Probing().poses_deg)
RADIUS_M, HEIGHT_M = 0.12, 0.08
DESIGN = design_matrix(POSES, RADIUS_M, HEIGHT_M)
PROBE = Probe(POSES, RADIUS_M, HEIGHT_M, 1.0)
SIGMA = np.array([0.6, 0.6, 0.5, 0.5, 0.5, 0.5, 4.0, 4.0, 4.0])
UNKNOWN = np.full(9, math.nan)


def checks(**changed: float) -> MeasurementChecks:
    return MeasurementChecks(Probing(**changed), RADIUS_M)


def solved(errors: FloatArray, chip_um: FloatArray | None = None, noise: FloatArray | None = None) -> ProbingResult:
    deviations = (DESIGN @ errors).reshape(-1, 3)
    for more in (chip_um, noise):
        deviations = deviations if more is None else deviations + more
    return PROBE.solve(deviations)


def measurement(**errors: float) -> Measurement:
    names = ("EY0A", "EZ0A", "EX0C", "EY0C", "EZ0T", "ER0T", "EA0C", "EB0C", "EC0C")
    return Measurement(np.array([errors.get(n, 0.0) for n in names]), SIGMA)


def predicted(sigma_um: float = 1.0, limit_um: float = 3.0) -> Expected:
    scale = np.array([1.0] * 6 + [1 / RADIUS_M] * 3)
    return Expected(np.zeros(9), sigma_um * scale, limit_um * scale)


@pytest.mark.parametrize(
    ("spread", "believed"), [(None, True), (0.0, True), (9.9, True), (10.1, False), (math.nan, False)]
)
def test_repeated_touches_must_agree(spread: float | None, believed: bool) -> None:
    if believed:
        checks().repeats(spread)
    else:
        with pytest.raises(Rejected, match=r"repeated touches.*max_repeat_um"):
            checks().repeats(spread)


@pytest.mark.slow
def test_standardised_residuals_have_unit_variance_wherever_they_are() -> None:
    draw = np.random.default_rng(5)
    found = np.array([solved(np.zeros(9), noise=draw.normal(0.0, 1.0, (6, 3))).standardised for _ in range(2000)])
    np.testing.assert_allclose(found.std(axis=0), 1.0, atol=0.08)


@pytest.mark.slow
def test_a_clean_cycle_of_a_hot_machine_is_accepted() -> None:
    """Two thousand cycles with the declared noise: not one is rejected by the fit."""
    draw, judge = np.random.default_rng(6), checks()
    hot = np.array([3.0, 70.0, 20.0, -5.0, 25.0, 22.0, 60.0, -80.0, 15.0])
    for _ in range(2000):
        judge.fits(solved(hot, noise=draw.normal(0.0, 1.0, (6, 3))))


@pytest.mark.parametrize("pose", range(6))
@pytest.mark.parametrize("axis", range(3))
def test_a_chip_under_any_one_touch_is_found_and_its_pose_named(pose: int, axis: int) -> None:
    """20 µm, the swarf of a finishing cut, under probing noise of 1 µm: found at every place in 50 of 50 cycles."""
    draw, judge = np.random.default_rng([pose, axis]), checks()
    chip = np.zeros((6, 3))
    chip[pose, axis] = 20.0
    for _ in range(50):
        with pytest.raises(Rejected, match="is the sphere clean") as found:
            judge.fits(solved(np.zeros(9), chip, draw.normal(0.0, 1.0, (6, 3))))
    if axis == 0 or pose == 0:  # elsewhere another pose may stand out as much: the poses share few equations there
        assert f"pose {pose + 1} stands out in {'XYZ'[axis]}" in str(found.value)


def test_what_a_chip_that_is_missed_can_do_is_small() -> None:
    """The largest chip that passes without noise, at any place, falsifies no position by more than 5 µm."""
    judge, worst = checks(), 0.0
    for pose in range(6):
        for axis in range(3):
            size = 0.0
            while True:
                chip = np.zeros((6, 3))
                chip[pose, axis] = size + 0.25
                result = solved(np.zeros(9), chip)
                try:
                    judge.fits(result)
                except Rejected:
                    break
                size += 0.25
                worst = max(worst, float(np.abs(result.errors[:6]).max()))
            assert size < 15.0
    assert 1.0 < worst < 5.0


def test_what_agrees_with_the_prediction_is_accepted_at_once() -> None:
    checks().plausible(measurement(EZ0A=6.5, EX0C=-4.0), predicted())


def test_a_surprise_must_be_found_a_second_time() -> None:
    judge = checks()
    with pytest.raises(Rejected, match=r"EZ0A differs by 20.0 µm from the prediction: a second cycle"):
        judge.plausible(measurement(EZ0A=20.0), predicted())
    judge.plausible(measurement(EZ0A=21.0), predicted())
    with pytest.raises(Rejected, match="a second cycle"):  # and the next surprise again
        judge.plausible(measurement(EZ0A=21.0), predicted())


@pytest.mark.parametrize("moved", [-9.9, 9.9])
def test_a_machine_that_warms_on_between_two_cycles_confirms_a_surprise(moved: float) -> None:
    """A spindle was started after the latest prediction. Six minutes later both have moved by about as much: the
    figures are those of a soak, 22.3 µm where 10.9 were predicted, then 31.1 and 20.8."""
    started = predicted(sigma_um=1.2)
    later = Expected(started.errors + moved * (np.arange(9) == 1), started.sigma, started.limits)
    for second in (0.89 * moved, moved, 0.0):  # as the prediction moved, or not at all
        judge = checks()
        with pytest.raises(Rejected, match="a second cycle"):
            judge.plausible(measurement(EZ0A=math.copysign(11.4, moved)), started)
        judge.plausible(measurement(EZ0A=math.copysign(11.4, moved) + second), later)
    for second in (-0.7 * moved, 1.9 * moved):  # neither the same result nor the same surprise
        judge = checks()
        with pytest.raises(Rejected, match="a second cycle"):
            judge.plausible(measurement(EZ0A=math.copysign(30.0, moved)), started)
        with pytest.raises(Rejected, match="a second cycle"):
            judge.plausible(measurement(EZ0A=math.copysign(30.0, moved) + second), later)


def test_a_probe_that_sits_differently_each_time_is_never_accepted() -> None:
    """Dirt in the taper shifts all touches alike: the fit cannot see it, but a probe that is fetched again is shifted
    differently."""
    judge, draw = checks(), np.random.default_rng(7)
    for shift in draw.permutation(np.linspace(-45.0, 45.0, 10)):
        with pytest.raises(Rejected, match="a second cycle"):
            judge.plausible(measurement(EZ0A=float(shift), EY0A=20.0), predicted())


def test_after_a_plausible_result_the_next_surprise_is_rejected_as_a_first_one() -> None:
    judge = checks()
    with pytest.raises(Rejected):
        judge.plausible(measurement(EZ0A=20.0), predicted())
    judge.plausible(measurement(EZ0A=0.5), predicted())
    with pytest.raises(Rejected, match="a second cycle"):
        judge.plausible(measurement(EZ0A=20.0), predicted())


def test_within_the_action_control_limit_nothing_is_a_surprise() -> None:
    checks().plausible(measurement(EZ0A=9.0), predicted(sigma_um=0.2, limit_um=10.0))


def test_an_absurd_result_is_not_accepted_however_often_it_is_found() -> None:
    judge = checks()
    for _ in range(5):
        with pytest.raises(Rejected, match="more than is possible"):
            judge.plausible(measurement(EZ0A=80.0), predicted())
    with pytest.raises(Rejected, match=r"EC0C differs by 500.0 µm/m"):  # 60 µm at the sphere
        judge.plausible(measurement(EC0C=500.0), predicted())


def test_a_prediction_that_is_unsure_rejects_little() -> None:
    checks().plausible(measurement(EZ0A=80.0), predicted(sigma_um=20.0))


def test_without_a_model_a_recent_measurement_stands_in_and_only_the_absurd_is_rejected() -> None:
    last = Expected(np.zeros(9), UNKNOWN, UNKNOWN)
    checks().plausible(measurement(EZ0A=45.0), last)
    with pytest.raises(Rejected, match="more than is possible"):
        checks().plausible(measurement(EZ0A=55.0), last)
    checks().plausible(measurement(EZ0A=500.0), Expected(UNKNOWN, UNKNOWN, UNKNOWN))
