"""The report says of each coordinate at the tool for which errors it is corrected, and why not for the others."""

import re
from dataclasses import replace
from typing import Literal

import numpy as np
import pytest

from gateway.reporting.coordinates import CoordinateRow, by_coordinate
from gateway.reporting.data import ReportData
from talc.frame import Phase
from talc.names import THERMAL_ERRORS
from tests.benches.small_run import small_run


def rows(data: ReportData) -> dict[str, CoordinateRow]:
    return {row.name: row for row in by_coordinate(data)}


def errors_of(told: str) -> list[str]:
    return re.findall(r"E[XYZABCR]0[ACT]", told)


def with_trust(data: ReportData, **steps: int) -> ReportData:
    """Errors that are corrected in the first steps only."""
    trusted = np.ones((len(data.k), 9), dtype=np.bool_)
    for name, many in steps.items():
        trusted[many:, THERMAL_ERRORS.index(name)] = False
    return replace(data, trusted=trusted)


def test_a_coordinate_that_all_its_errors_correct_has_no_reason() -> None:
    found = rows(small_run())
    assert found["X"].corrected == "EX0C, ER0T, EB0C, EC0C"
    assert found["Z"].corrected == "EZ0A, EY0C, EZ0T, ER0T, EA0C, EB0C, EC0C"
    assert {row.not_corrected for row in found.values()} == {""}


def test_an_error_whose_estimate_is_no_better_than_none_is_named_with_its_share_of_the_steps() -> None:
    found = rows(with_trust(small_run(48), EX0C=12, EZ0A=0))
    assert found["X"].corrected == "EX0C (25 % of the steps), ER0T, EB0C, EC0C"
    assert found["X"].not_corrected == "EX0C: its estimate is no better than no correction (75 % of the steps)"
    assert found["Z"].not_corrected == "EZ0A: its estimate is no better than no correction"
    assert found["Y"].not_corrected == "", "neither of the two moves Y"


def test_a_coordinate_that_is_never_touched_has_a_reason_for_each_error() -> None:
    found = rows(with_trust(small_run(), EX0C=0, ER0T=0, EB0C=0, EC0C=0))["X"]
    assert found.corrected == "nothing"
    assert errors_of(found.not_corrected) == ["EX0C", "ER0T", "EB0C", "EC0C"]


def test_with_trained_models_an_error_without_one_is_distinguished_from_one_that_was_never_measured() -> None:
    run = small_run()
    predicted, corrected = run.predicted.copy(), run.corrected.copy()
    ex0c, eb0c = THERMAL_ERRORS.index("EX0C"), THERMAL_ERRORS.index("EB0C")
    predicted[:, [ex0c, eb0c]] = np.nan
    corrected[:, eb0c] = np.nan
    found = rows(replace(run, predicted=predicted, corrected=corrected))["X"]
    assert errors_of(found.corrected) == ["EX0C", "ER0T", "EC0C"]
    assert errors_of(found.not_corrected) == ["EB0C"]
    without = rows(with_trust(small_run(), EB0C=0))["X"]
    assert errors_of(without.not_corrected) == ["EB0C"]
    assert without.not_corrected != found.not_corrected, "another reason"
    assert without.corrected != found.corrected, "EX0C by its last measurement"


@pytest.mark.parametrize("mode", ["monitor", "advise"])
def test_what_writes_nothing_touches_no_coordinate(mode: Literal["monitor", "advise"]) -> None:
    for row in rows(replace(small_run(), mode=mode)).values():
        assert (row.corrected, mode in row.not_corrected) == ("nothing", True)


def test_before_corrections_begin_nothing_is_touched_and_a_recording_has_no_tool() -> None:
    run = small_run()
    for row in rows(replace(run, phases=(Phase.CALIBRATION,) * len(run.k))).values():
        assert (row.corrected, errors_of(row.not_corrected), bool(row.not_corrected)) == ("nothing", [], True)
    assert by_coordinate(replace(run, recorded=run.measured)) == ()
