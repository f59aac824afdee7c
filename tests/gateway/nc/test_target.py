"""Which errors the offsets cancel, and for how long they count. Times are arguments."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

import numpy as np
import pytest

from drivers.base import Quality
from gateway.config.sections import Compensation
from gateway.model.compensation import Source
from gateway.nc.target import Target
from gateway.nc.unmodelled import LastMeasured
from talc.frame import Measurement
from tests.benches.nc_link_bench import decision


def target(when_stale: Literal["zero", "hold"] = "zero", missing_s: Mapping[str, float] | None = None) -> Target:
    settings = Compensation(when_stale=when_stale, stale_after_s=60.0, inputs_stale_after_s=30.0)
    return Target(settings, LastMeasured(200.0, [0.0] * 9), missing_s or {})


def test_before_the_first_decision_there_is_no_target() -> None:
    assert target().errors(Quality.GOOD, 5.0) == (None, Source.NO_MODEL)
    assert target().decision is None


def test_a_decision_counts_until_it_is_stale() -> None:
    at = target()
    at.follow(decision(4.0), 10.0)
    errors, source = at.errors(Quality.GOOD, 70.0)
    assert errors is not None
    assert (errors[1], source) == (4.0, Source.PREDICTION)
    assert at.errors(Quality.GOOD, 70.1) == (None, Source.STALE)
    at.follow(decision(5.0), 71.0)
    assert at.errors(Quality.GOOD, 100.0)[1] is Source.PREDICTION


def test_a_renewed_correction_counts_as_long_as_its_decision_and_only_until_the_next() -> None:
    at = target()
    at.follow(decision(4.0), 10.0)
    at.renew(decision(4.5).corrected)
    errors, source = at.errors(Quality.GOOD, 70.0)
    assert errors is not None
    assert (errors[1], source) == (4.5, Source.PREDICTION)
    assert at.errors(Quality.GOOD, 70.1) == (None, Source.STALE)
    at.follow(decision(5.0), 71.0)
    errors, _ = at.errors(Quality.GOOD, 71.0)
    assert errors is not None
    assert errors[1] == 5.0


def test_renewing_does_not_revive_an_error_whose_measurement_is_too_old() -> None:
    at, long_valid = Target(Compensation(), LastMeasured(200.0, [0.0] * 9), {}), 300.0
    at.follow(replace(decision(4.0), predicted=np.full(9, math.nan)), 100.0)
    at.renew(decision(4.5).corrected)
    assert at.errors(Quality.GOOD, 200.0)[1] is Source.PREDICTION
    assert at.errors(Quality.GOOD, long_valid) == (None, Source.NO_MODEL)


def test_before_the_first_decision_a_correction_is_not_used() -> None:
    at = target()
    at.renew(decision(4.5).corrected)
    assert at.errors(Quality.GOOD, 5.0) == (None, Source.NO_MODEL)


@pytest.mark.parametrize("quality", [each for each in Quality if each is not Quality.GOOD])
def test_nothing_is_built_on_a_snapshot_that_is_not_good(quality: Quality) -> None:
    at = target()
    at.follow(decision(4.0), 10.0)
    assert at.errors(quality, 11.0) == (None, Source.STALE)


def test_a_missing_input_counts_from_when_it_went_missing() -> None:
    at = target(missing_s={"spindle_front": -25.0, "bed": -90.0})  # of an earlier run
    lacking = replace(decision(4.0), substituted=("spindle_front",))
    at.follow(lacking, 3.0)
    assert at.missing_s == {"spindle_front": -25.0}, "the other one has come back"
    assert at.errors(Quality.GOOD, 5.0)[1] is Source.PREDICTION
    at.follow(lacking, 5.1)
    assert at.errors(Quality.GOOD, 5.1) == (None, Source.INPUTS_STALE)
    at.follow(decision(4.0), 6.0)
    at.follow(lacking, 7.0)
    assert at.errors(Quality.GOOD, 37.0)[1] is Source.PREDICTION
    assert at.errors(Quality.GOOD, 37.1)[1] is Source.INPUTS_STALE


def test_by_default_an_input_may_be_missing_for_half_an_hour() -> None:
    at, lacking = (
        Target(Compensation(), LastMeasured(200.0, [0.0] * 9), {}),
        replace(decision(4.0), substituted=("bed",)),
    )
    for now_s in (0.0, 900.0, 1800.0):
        at.follow(lacking, now_s)
    assert at.errors(Quality.GOOD, 1800.0)[1] is Source.PREDICTION
    assert at.errors(Quality.GOOD, 1800.1)[1] is Source.INPUTS_STALE


def test_times_that_are_not_known_are_too_old_until_they_are_known() -> None:
    settings = Compensation(stale_after_s=60.0, inputs_stale_after_s=30.0)
    unknown = -math.inf
    at = Target(settings, LastMeasured(200.0, [unknown] * 9), {"bed": unknown})
    without_model = replace(decision(4.0), predicted=np.array([3.0, *[math.nan] * 8]), substituted=("bed",))
    at.follow(without_model, 10.0)
    assert at.errors(Quality.GOOD, 10.0) == (None, Source.INPUTS_STALE)
    at.remembered([unknown] * 9, {"bed": unknown})
    assert at.errors(Quality.GOOD, 11.0) == (None, Source.INPUTS_STALE)
    at.remembered([unknown, -50.0, *[unknown] * 7], {"bed": 5.0, "column": -9.0})
    assert at.missing_s == {"bed": 5.0}
    errors, source = at.errors(Quality.GOOD, 12.0)
    assert errors is not None
    assert (errors[1], source) == (4.0, Source.PREDICTION)
    assert errors[2] == 0.0, "never measured, as far as is known"
    at.remembered([11.0] * 9, {"bed": 12.0})
    assert at.missing_s == {"bed": 5.0}, "what is known stays"


@pytest.mark.parametrize("when_stale", ["zero", "hold"])
def test_without_any_known_error_there_is_no_target(when_stale: Literal["zero", "hold"]) -> None:
    at = target(when_stale)
    at.follow(replace(decision(4.0), corrected=np.full(9, math.nan)), 1.0)
    assert at.errors(Quality.GOOD, 2.0) == (None, Source.NO_MODEL)


def test_an_unknown_error_is_left_alone_and_a_measured_one_counts_for_a_limited_time() -> None:
    at = target()
    known = replace(decision(4.0), predicted=np.array([3.0, *[math.nan] * 8]))
    known.corrected[0], known.corrected[5] = 3.0, math.nan
    at.follow(known, 190.0)
    errors, _ = at.errors(Quality.GOOD, 199.0)
    assert errors is not None
    np.testing.assert_array_equal(errors[[0, 1, 5]], [3.0, 4.0, 0.0])
    errors, _ = at.errors(Quality.GOOD, 201.0)
    assert errors is not None
    np.testing.assert_array_equal(errors[[0, 1, 5]], [3.0, 0.0, 0.0])
    at.measured(Measurement(np.ones(9), np.ones(9)), 202.0)
    errors, _ = at.errors(Quality.GOOD, 203.0)
    assert errors is not None
    assert errors[1] == 4.0


def test_with_hold_a_measured_error_counts_however_old_it_is() -> None:
    at = target("hold")
    at.follow(replace(decision(4.0), predicted=np.full(9, math.nan)), 1e6)
    errors, source = at.errors(Quality.GOOD, 1e6)
    assert errors is not None
    assert (errors[1], source) == (4.0, Source.PREDICTION)


def test_nothing_is_built_on_what_cannot_be_stored() -> None:
    stored = True
    at = Target(Compensation(), LastMeasured(200.0, [0.0] * 9), {}, lambda: stored)
    at.follow(decision(4.0), 0.0)
    assert at.errors(Quality.GOOD, 5.0)[1] is Source.PREDICTION
    stored = False
    assert at.errors(Quality.GOOD, 5.0) == (None, Source.NOT_STORED)
