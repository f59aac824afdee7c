"""Adaptive inputs: seasons in sequence, repetitions on the same physics, and the whole small version."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from simulators.cases import LONG_TERM_H
from studies import STUDIES, Run
from studies.adaptive_inputs import CALIBRATION, SMALL_STEPS, season_days
from studies.adaptive_inputs_pictures import against, borders
from studies.adaptive_inputs_report import WAYS
from studies.page import Claim
from talc.names import THERMAL_ERRORS
from tests.benches.small_study import Studied, study_by_command

pytestmark = pytest.mark.slow

STUDY = STUDIES["adaptive-inputs"]


@pytest.fixture(scope="module")
def studied(tmp_path_factory: pytest.TempPathFactory) -> Studied:
    return study_by_command(STUDY.name, tmp_path_factory.mktemp("study"), "selector=search,learner")


@pytest.fixture(scope="module")
def small(studied: Studied) -> list[Run]:
    """The small study's runs of the default selector."""
    return [run for run in studied.runs if run.parameters["selector"] == "search"]


def test_the_full_study_is_25_repetitions_of_every_way() -> None:
    wanted = STUDY.runs(1, False)
    assert len(wanted) == 150 + 25
    assert {(p["selector"], p["inputs"]) for p in wanted} == set(WAYS)


def test_a_repetition_is_other_noise_on_the_same_days(small: list[Run]) -> None:
    one, two = season_days(1, 0, True), season_days(1, 1, True)
    assert np.array_equal(one.truth, two.truth)
    assert not np.array_equal(one.measured, two.measured)
    apart = one.inputs[:, :29] - two.inputs[:, :29]
    assert 0.03 < apart.std() < 0.12  # two draws of 0.05 K in steps of 0.1 K
    before = small[0].result["none"]["E_PV"]
    assert before == pytest.approx(np.ptp(one.truth[CALIBRATION + 1 :], axis=0).tolist())


def test_the_learner_is_measured_each_2_h_and_no_more(studied: Studied) -> None:
    (run,) = [run for run in studied.runs if run.parameters["selector"] == "learner"]
    assert run.result["measurements"] == 1 + (SMALL_STEPS - CALIBRATION - 1) // 24
    assert run.result["updates"] == []
    left, hold, none = (np.mean(run.result[what]["E_RMS"][:6]) for what in ("models", "hold", "none"))
    assert left < 0.5 * hold < 0.5 * none


def test_static_inputs_stay_and_adaptive_ones_are_chosen_again(small: list[Run]) -> None:
    by_inputs = {run.parameters["inputs"]: run.result for run in small}
    for result in by_inputs.values():
        assert result["inputs"][0]["after"] <= CALIBRATION
        assert len(result["inputs"]) == len(result["updates"]) + 1 >= 2
    first, *later = ({e: set(m.get(e, ())) for e in THERMAL_ERRORS} for m in by_inputs["static"]["inputs"])
    assert all(models[e] <= first[e] for models in later for e in THERMAL_ERRORS)
    first, *later = ({e: set(m.get(e, ())) for e in THERMAL_ERRORS} for m in by_inputs["adaptive"]["inputs"])
    assert any(models[e] - first[e] for models in later for e in THERMAL_ERRORS)


def test_models_leave_less_than_nothing_and_than_the_held_measurement(small: list[Run]) -> None:
    for run in small:
        left, hold, none = (np.mean(run.result[what]["E_RMS"][:6]) for what in ("models", "hold", "none"))
        assert left < 0.5 * hold < 0.5 * none


def made_up(
    selector: str, inputs: str, repetition: int, left: Sequence[float], none: Sequence[float] = (9.0,) * 9
) -> Run:
    parameters = {"seed": 1, "repetition": repetition, "selector": selector, "inputs": inputs, "small": False}
    figures = {
        what: {"E_PV": list(v), "E_RMS": list(v)} for what, v in (("none", none), ("hold", none), ("models", left))
    }
    return Run(parameters, {**figures, "updates": [], "measurements": 0, "inputs": []})


def claims_of(runs: list[Run]) -> dict[str, Claim]:
    return {claim.text: claim for claim in STUDY.report(runs).claims}


def test_a_smaller_mean_is_no_proof_when_repetitions_differ_by_more() -> None:
    for left, holds in (((3.0, 8.0, 9.0, 7.0), False), ((6.4, 6.1, 6.9, 6.2), True)):
        assert np.mean(left) < 7.0
        runs = [made_up("pso", "static", r, [7.0] * 9) for r in range(4)]
        runs += [made_up("pso", "adaptive", r, [v] * 9) for r, v in enumerate(left)]
        claim = claims_of(runs)["Adaptive inputs leave less than static ones (pso)"]
        assert claim.holds is holds


def test_repetitions_are_compared_with_their_like_whatever_their_order() -> None:
    static = [made_up("pso", "static", r, [10.0 * r + 1.0] * 9) for r in range(4)]
    adaptive = [made_up("pso", "adaptive", r, [10.0 * r] * 9) for r in reversed(range(4))]
    claim = claims_of(static + adaptive)["Adaptive inputs leave less than static ones (pso)"]
    assert claim.holds
    assert "less in 4 of 4" in claim.here


def test_the_papers_small_errors_are_those_two_and_no_other() -> None:
    text = "EY0A and EY0C do not improve (pso)"
    other, both = [5.0] * 9, [5.0] * 9
    other[THERMAL_ERRORS.index("EC0C")] = 12.0
    for name in ("EY0A", "EY0C"):
        both[THERMAL_ERRORS.index(name)] = 12.0
    for left, holds in ((other, False), (both, True)):
        claim = claims_of([made_up("pso", "adaptive", r, left) for r in range(3)])[text]
        assert claim.holds is holds
    assert claim.here.endswith(": EY0A, EY0C")


def test_each_printed_figure_stands_beside_ours() -> None:
    runs = [made_up("pso", "static", r, [4.0 + r] * 9, [8.0] * 9) for r in (0, 1)]
    runs += [made_up("pso", "adaptive", r, [2.0 + r] * 9, [8.0] * 9) for r in (0, 1)]
    runs += [made_up("tck", "adaptive", r, [6.0] * 9, [8.0] * 9) for r in (0, 1)]
    beside: Any = STUDY.report(runs).sections[-1].blocks[1]
    ours = {row.cells[0]: row.cells[2] for row in beside.rows}
    assert len(ours) == 120
    assert ours["Table 3, EX0C, E_PV, uncompensated, µm"] == "8"
    assert ours["Table 3, EX0C, E_PV, reduction, %"] == "68.8"  # to 2.5 of 8
    assert ours["Table 4, EC0C, E_RMS, reduction, static, %"] == "43.8"  # to 4.5
    assert ours["text, mean E_PV of six, TCK, µm"] == "6"
    assert ours["text, deviation of E_PV of six, adaptive against static, % less"] == "0"
    assert ours["text, reduction of E_PV of six, Group-LASSO over TCK, % higher"] == "175"  # 68.75 over 25
    assert ours["text, limit of EX0C in the single run, static, µm"] == "–"


def test_a_single_run_shows_limits_chosen_inputs_and_what_is_left() -> None:
    def drawn(inputs: str, limits: Sequence[float | None], sets: Sequence[Sequence[str]], left: float) -> Run:
        run = made_up("pso", inputs, 0, [left] * 9)
        series: list[list[float | None]] = [list(limits)] * 9
        shown = {"step_h": 0.25, "truth": [[8.0] * 4] * 9, "left": [[None, 1.0, left, 3.0]] * 9, "limits": series}
        chosen = [{"after": 12 * k, "EX0C": list(own)} for k, own in enumerate(sets)]
        return Run(run.parameters, {**run.result, "drawn": shown, "updates": [12] * (len(sets) - 1), "inputs": chosen})

    static = drawn("static", (None, 9.0, 9.0, 15.0), (("a",), ("a",)), 6.0)
    adaptive = drawn("adaptive", (None, 5.0, 5.0, 8.0), (("a",), ("a", "b"), ("b",)), 4.0)
    claims = claims_of([static, adaptive])
    limits = claims["In a single run adaptive inputs have narrower limits of EX0C (pso)"]
    assert limits.holds
    assert limits.here == "5.0 to 8.0 µm against 9.0 to 15.0 µm"
    assert claims["In a single run adaptive inputs leave less of EX0C (pso)"].holds
    assert claims["The chosen inputs change over time (pso)"].here.startswith("3 different sets of EX0C in 3 trainings")
    rows = against(static, adaptive).rows
    at = dict(zip(rows[0], zip(*rows[1:], strict=True), strict=True))
    assert at["EX0C static limit"] == ("nan", "9", "", "15")
    assert at["EX0C adaptive left"] == ("nan", "1", "4", "3")
    swapped = claims_of([drawn("static", (5.0,) * 4, (("a",),), 4.0), drawn("adaptive", (9.0,) * 4, (("a",),), 6.0)])
    assert not any(claim.holds for text, claim in swapped.items() if "single run" in text or "over time" in text)
    beside: Any = STUDY.report([static, adaptive]).sections[-1].blocks[1]
    ours = {row.cells[0]: row.cells[2] for row in beside.rows}
    assert ours["text, limit of EX0C in the single run, static, µm"] == "15"
    assert ours["text, model updates of the single run, static"] == "1"


def test_the_borders_of_the_seasons_are_drawn_where_the_next_one_begins() -> None:
    begins = season_days(1, 0, False).begins
    assert [b / 12 for b in begins[1:]] == np.cumsum(list(LONG_TERM_H.values()))[:-1].tolist() == borders(340.0)
    assert borders(100.0) == []
