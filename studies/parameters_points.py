"""One set of parameters with its figures, and the best among many."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from studies.frame import Run

StudyPoint = Mapping[str, Any]
ByCase = Mapping[str, list[StudyPoint]]
Key = tuple[Any, ...]
"""Calibration h, interval h, no-good measurements; or calibration h and policy."""

TARGET_UM = 5.0
BEST = (6.5, 2.0, 12)
"""Calibration h, interval h, no-good measurements: the paper's best common set."""


FRONTS = {
    "fixed": "fixed interval",
    "adaptive": "policy",
    "sparse_fixed": "fixed interval, sparse calibration",
    "sparse_adaptive": "policy, sparse calibration",
    "regression": "regression",
    "sparse_regression": "regression, sparse calibration",
    "learner": "learner",
}
"""Kinds of points in the runs' results, and their titles: B19's grid, the policies after the same calibrations, both
after calibrations measured less often, and the regression measured at the same fixed intervals."""


def fronts_of(runs: list[Run]) -> dict[str, ByCase]:
    """Points of the sets that were tried on one series, by kind and load case."""
    tried = [run for run in runs if "sets" not in run.parameters]
    cases = dict.fromkeys(str(run.parameters["case"]) for run in tried)
    return {kind: {case: points_of(tried, case, kind) for case in cases} for kind in FRONTS}


def points_of(runs: list[Run], case: str, kind: str) -> list[StudyPoint]:
    found: list[StudyPoint] = []
    for run in runs:
        if run.parameters["case"] == case:
            at = {"calibration_h": run.parameters.get("calibration_h")}
            found += [{**at, **point} for point in run.result.get(kind, [])]
    return found


def chosen_sets(runs: list[Run]) -> list[Key]:
    """The paper's best common set, and the best common one of each front that has one."""
    common = [best_common(points) for points in fronts_of(runs).values()]
    return list(dict.fromkeys([BEST, *(key for key in common if key is not None)]))


def key_of(point: StudyPoint) -> Key:
    if "policy" in point:
        return point["calibration_h"], point["policy"]
    return point["calibration_h"], point["interval_h"], point["no_good"]


def name_of(key: Key) -> str:
    if len(key) == 2:
        return f"{key[0]:g} h, then {key[1]}"
    return f"{key[0]:g} h, then {key[1]:g} h, no good {key[2]} × 10 min"


def point_at(points: list[StudyPoint], key: Key) -> StudyPoint | None:
    return next((p for p in points if key_of(p) == key), None)


def fewest_for(points: list[StudyPoint], p99: float) -> StudyPoint | None:
    """The point with the fewest measurements and a P99 of at most `p99`."""
    good = [p for p in points if p["P99"] <= p99]
    return min(good, key=lambda p: (p["measurements"], p["P99"])) if good else None


def best_common(fixed: ByCase) -> Key | None:
    """The set with the largest mean Pd among those whose P99 is below the target on every load case."""
    by_key: dict[Key, list[StudyPoint]] = {}
    for points in fixed.values():
        for point in points:
            by_key.setdefault(key_of(point), []).append(point)
    good = {k: p for k, p in by_key.items() if all(x["P99"] < TARGET_UM for x in p) and len(p) == len(fixed)}
    return max(good, key=lambda k: float(np.mean([p["Pd"] for p in good[k]]))) if good else None


def mean_made(points: ByCase, key: Key | None) -> float:
    """Mean number of measurements over the load cases; NaN without a common set."""
    if key is None:
        return float("nan")
    found = [point_at(at, key) for at in points.values()]
    return float(np.mean([p["measurements"] for p in found if p is not None])) if found else float("nan")


def rivals(
    fixed: list[StudyPoint], adaptive: list[StudyPoint]
) -> list[tuple[str, float, StudyPoint | None, StudyPoint | None]]:
    """Fewest measurements by fixed interval and by policy, for the target P99 and for that of the paper's best set."""
    targets = [("P99 of at most 5 µm", TARGET_UM)]
    best = point_at(fixed, BEST)
    if best is not None:
        targets.append((f"the paper's set's own P99, {best['P99']:.2f} µm", float(best["P99"])))
    return [(title, value, fewest_for(fixed, value), fewest_for(adaptive, value)) for title, value in targets]


def after_equal_calibrations(fixed: list[StudyPoint], adaptive: list[StudyPoint]) -> list[tuple[float, int, int]]:
    """Per calibration length: fewest measurements after it for the target, by a fixed interval and by a policy."""
    found = []
    for length in sorted({float(p["calibration_h"]) for p in fixed}):
        plain, own = (
            fewest_for([p for p in points if p["calibration_h"] == length], TARGET_UM) for points in (fixed, adaptive)
        )
        if plain is not None and own is not None:
            before = round(length * 6)
            found.append((length, plain["measurements"] - before, own["measurements"] - before))
    return found


def median_share(pairs: list[tuple[float, int, int]]) -> float:
    """Median ratio, policy to fixed; NaN without pairs."""
    return float(np.median([own / plain for _, plain, own in pairs])) if pairs else float("nan")


def fewest_ratio(cases: list[str], fixed: ByCase, other: ByCase) -> float:
    """Mean over the load cases of the fewest measurements for the target, other to fixed; NaN without any."""
    pairs = [(fewest_for(fixed[c], TARGET_UM), fewest_for(other[c], TARGET_UM)) for c in cases]
    ratios = [own["measurements"] / plain["measurements"] for plain, own in pairs if plain and own]
    return float(np.mean(ratios)) if ratios else float("nan")
