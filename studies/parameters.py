"""Length of calibration, interval of measuring and amount of relearning, as in B19, in every combination on four loads.

Then policies that decide by themselves when to measure, on the same series, with the same limits.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal, get_args

import numpy as np

from simulators.cases import Letter, table_and_fluid
from simulators.plant import MACHINES, MachineDrive, Plant, load_machine, record_drive
from studies.frame import Run, RunParameters, Study
from studies.loop import Course, Days, control, days, fitted_in_hindsight, held, regressed
from studies.parameters_points import chosen_sets, name_of
from studies.parameters_report import report
from talc import indicators
from talc.frame import BoolArray, FloatArray, TrainingJob
from talc.models import ModelSet
from talc.names import ERROR_UNITS, MICROMETRE, THERMAL_ERRORS
from talc.papers.training import train
from talc.settings import ControlSettings, LearnerSettings, TalcSettings, TrainingSettings

STEP_S = 600.0
"""B19's no-good measurements come every 10 min."""
HOURS = 96.0
IDLE_S = 12 * 3600.0
CYCLE_S = 95.0
"""B19's probing cycle."""
CALIBRATION_H = (4.0, 5.0, 6.5, 8.0, 9.5, 11.0, 12.5, 14.0, 16.0, 18.0, 20.0, 22.0, 24.0)
INTERVAL_H = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0)
NO_GOOD = tuple(range(2, 27, 2))
"""13 x 13 x 13 = 2,197 combinations. B19 has 2,191 others (studies.printed); its best common set is among ours."""
BEST_NO_GOOD = 12
"""The paper's best common set: 6.5 h, then 2 h, no good 12 x 10 min."""
SHARES, SOONEST_H = (1.0, 1.5, 2.0, 3.0), 0.5
"""For the policy `uncertainty`: share of the limit that an interval may fill; it measures at most this often."""
SHORTEST_H = (2.0, 4.0)
"""For the policy `novelty`."""
LONGEST_H, POLICY_NO_GOOD = (8.0, 16.0), (2, 4)
SPARSE, LEAST_CALIBRATION = (2, 3, 6), 24
"""Steps between measurements of sparse calibrations; the least number of measurements that a training needs."""
LEARNT_H, HOURLY = (12.0, 24.0), 6
"""The learner is measured every hour at first, for this number of steps."""
LEARNT_UM = (2.5, 3.5, 5.0, 7.0, 10.0)
"""Limits of uncertainty at which the learner requests measurements itself."""
OTHER_SEEDS = 3
"""Seeds and machines on which the chosen sets are judged again."""
SPARSE_INTERVAL_H, SPARSE_NO_GOOD = (1.0, 2.0, 3.0, 4.0, 6.0, 8.0), (2, 4, 8, 12)
"""Fixed intervals after such a calibration: as many sets as there are policies."""
_SMALL = ("uncertainty 2, 0.5 to 16 h, 4", "each 4 h, 4")
"""One set of each kind, for the small version."""
TRAINING = TrainingSettings(static_inputs=True, max_nb=1)
"""Inputs are chosen in the calibration and kept, as B19's are; orders up to 1 and parameters are renewed."""
_LEARNER_WAYS = (
    *(f"learner each {h:g} h" for h in SPARSE_INTERVAL_H),
    *(f"learner within {um:g} µm" for um in LEARNT_UM),
)
POSITIONS = np.array([ERROR_UNITS[name] == MICROMETRE for name in THERMAL_ERRORS])


def runs(seed: int, small: bool) -> list[RunParameters]:
    """One run for each load case and calibration length; the small version has two with a few combinations.

    The regression also has one run for each load case, with as many intervals and calibrations as the models have.
    """
    cases, calibrations = (("A",), (6.5, 8.0)) if small else (get_args(Letter), CALIBRATION_H)
    grid = [
        {"seed": seed, "case": case, "calibration_h": length, "small": small}
        for case in cases
        for length in calibrations
    ]
    peers = ("regression", "learner")
    return [*grid, *({"seed": seed, "case": case, "peer": peer, "small": small} for case in cases for peer in peers)]


def learns(parameters: RunParameters) -> bool:
    """Whether a run uses the learner. Runs of chosen sets do: some of these sets are the learner's."""
    return "sets" in parameters or parameters.get("peer") == "learner"


def then(first: list[Run]) -> list[RunParameters]:
    """Runs of the sets chosen on one seed and machine: there with more comparisons, and on other seeds and machines."""
    seed, small = first[0].parameters["seed"], first[0].parameters["small"]
    seeds, machines = (1, ("warm",)) if small else (OTHER_SEEDS, MACHINES[1:])
    places = [(seed + n, "base") for n in range(seeds + 1)] + [(seed, machine) for machine in machines]
    sets = [list(chosen) for chosen in chosen_sets(first)]
    return [
        {"seed": s, "case": case, "machine": machine, "sets": sets, "peers": (s, machine) == places[0], "small": small}
        for s, machine in places
        for case in dict.fromkeys(run.parameters["case"] for run in first)
    ]


def case_days(case: Letter, seed: int, machine: str = "base") -> Days:
    """The load case on the machine, with the noise of probing."""
    stretch = table_and_fluid(case, seed, hours=HOURS, step_s=STEP_S)
    plant = Plant(load_machine(machine), stretch.environment, seed)
    plant.advance(IDLE_S, MachineDrive())
    plant.zero()
    return days(record_drive(plant, stretch.drives, STEP_S), seed)


def run(parameters: RunParameters) -> Mapping[str, Any]:
    """Figures of one calibration length, of the regression's sets, or of the chosen sets on one series."""
    if "sets" in parameters:
        return _chosen(parameters)
    match parameters.get("peer"):
        case "regression":
            return _regression(parameters)
        case "learner":
            return _learner(parameters)
        case _:
            return _grid(parameters)


def _grid(parameters: RunParameters) -> Mapping[str, Any]:
    """For one calibration length every interval and no-good length (`fixed`), every policy (`adaptive`), the same after
    calibrations measured less often (`sparse_fixed`, `sparse_adaptive`), and `none`."""
    here = case_days(parameters["case"], parameters["seed"])
    calibration = parameters["calibration_h"]
    first: dict[tuple[int, int], ModelSet] = {}

    def learn(job: TrainingJob) -> ModelSet:
        # The first training sees the same rows in every combination.
        if job.static_inputs is not None:
            return train(job)
        seen = (job.k, int(np.isfinite(job.measured).any(axis=1).sum()))
        if seen not in first:
            first[seen] = train(job)
        return first[seen]

    def judge(settings: ControlSettings) -> tuple[dict[str, float], BoolArray]:
        course = control(here, TalcSettings(method="models", control=settings, training=TRAINING), learn)
        figures = figures_of(here.truth, course.estimate, course.used, calibration)
        figures["updates"] = max(len(course.updates) - 1, 0)
        hold = figures_of(here.truth, held(here, course.used), course.used, calibration)
        return {**figures, "hold P99": hold["P99"]}, course.used

    small = parameters["small"]
    fixed = []
    for interval in (2.0, 8.0) if small else INTERVAL_H:
        for no_good in (6, BEST_NO_GOOD) if small else NO_GOOD:
            figures, used = judge(_control(calibration, interval, no_good))
            if no_good == BEST_NO_GOOD:
                plain = figures_of(here.truth, regressed(here, used), used, calibration)
                figures["regression P99"] = plain["P99"]
            fixed.append({"interval_h": interval, "no_good": no_good, **figures})

    def of(kind: Callable[[float, int], list[tuple[str, ControlSettings]]], every: int) -> list[dict[str, Any]]:
        wanted = [(name, s) for name, s in kind(calibration, every) if not small or name in _SMALL]
        return [{"policy": name + _after(every), **judge(settings)[0]} for name, settings in wanted]

    sparse = _thinned(calibration)
    after = np.ones(len(here.truth), dtype=np.bool_)
    none = figures_of(here.truth, np.zeros_like(here.truth), ~after, calibration)
    return {
        "fixed": fixed,
        "adaptive": of(_policies, 1),
        "sparse_fixed": [point for every in sparse for point in of(_intervals, every)],
        "sparse_adaptive": [point for every in sparse for point in of(_policies, every)],
        "none": none,
    }


def _regression(parameters: RunParameters) -> Mapping[str, Any]:
    """Every fixed interval after every calibration, dense and sparse; and `hindsight`: a fit to all after 4 h."""
    here = case_days(parameters["case"], parameters["seed"])
    found: dict[str, list[dict[str, Any]]] = {"regression": [], "sparse_regression": []}
    for length in (6.5, 8.0) if parameters["small"] else CALIBRATION_H:
        for (every, interval), used in _plainly_measured(length).items():
            figures = figures_of(here.truth, regressed(here, used), used, length)
            at = {"calibration_h": length, "policy": _plain_name(every, interval)}
            found["regression" if every == 1 else "sparse_regression"].append({**at, **figures})
    after = np.arange(len(here.truth)) > _steps(CALIBRATION_H[0])
    best = figures_of(here.truth, fitted_in_hindsight(here, after), ~after, CALIBRATION_H[0])
    return {**found, "hindsight": best}


def _learner(parameters: RunParameters) -> Mapping[str, Any]:
    """The learner, measured each hour at first and then at a fixed interval or when it asks."""
    here = case_days(parameters["case"], parameters["seed"])
    lengths, found = (12.0,) if parameters["small"] else LEARNT_H, []
    for length in lengths:
        for name in _LEARNER_WAYS[:: 4 if parameters["small"] else 1]:
            course = _learnt(here, length, name)
            figures = figures_of(here.truth, course.estimate, course.used, length)
            found.append({"calibration_h": length, "policy": name, **figures})
    return {"learner": found}


def _learnt(here: Days, length_h: float, name: str) -> Course:
    """The learner's course, measured in the way of this name."""
    first = np.zeros(_steps(length_h) + 1, dtype=np.bool_)
    first[::HOURLY] = True
    number = float(name.split()[2])
    if " each " in name:
        used = np.zeros(len(here.truth), dtype=np.bool_)
        used[: len(first)] = first
        used[_steps(length_h) :: _steps(number)] = True
        return control(here, TalcSettings(method="learner"), measured=used, step_s=STEP_S)
    settings = LearnerSettings(
        limit_um=number,
        limit_um_per_m=3.0 * number,
        shortest_interval_steps=_steps(SOONEST_H),
        longest_interval_steps=_steps(LONGEST_H[-1]),
    )
    return control(here, TalcSettings(method="learner", learner=settings), measured=first, step_s=STEP_S)


def _chosen(parameters: RunParameters) -> Mapping[str, Any]:
    """`sets`: each chosen set's figures on this series; beside models, other methods with the same measurements."""
    here = case_days(parameters["case"], parameters["seed"], parameters["machine"])
    found = []
    for chosen in parameters["sets"]:
        calibration, name = chosen[0], name_of(tuple(chosen))
        plain = {_plain_name(*at): used for at, used in _plainly_measured(calibration).items()}
        if chosen[1] in _LEARNER_WAYS:
            course = _learnt(here, calibration, chosen[1])
            found.append({"set": name, **figures_of(here.truth, course.estimate, course.used, calibration)})
            continue
        if chosen[1] in plain:
            used = plain[chosen[1]]
            found.append({"set": name, **figures_of(here.truth, regressed(here, used), used, calibration)})
            continue
        settings = _settings(chosen)
        course = control(here, TalcSettings(method="models", control=settings, training=TRAINING))
        figures = figures_of(here.truth, course.estimate, course.used, calibration)
        figures["updates"] = max(len(course.updates) - 1, 0)
        if parameters["peers"]:
            figures |= _beside(here, settings, course, calibration)
        found.append({"set": name, **figures})
    first = CALIBRATION_H[0]
    none = figures_of(here.truth, np.zeros_like(here.truth), np.zeros(len(here.truth), dtype=np.bool_), first)
    return {"sets": found, "none": none}


def _beside(here: Days, settings: ControlSettings, course: Course, calibration_h: float) -> dict[str, float]:
    """P99 of other methods with a course's measurements, and of models that choose their inputs at each update."""
    renewed = np.zeros_like(course.used)
    renewed[: _steps(calibration_h) + 1] = True
    renewed[[k for k, _ in course.updates]] = True
    peers = {
        "hold P99": held(here, course.used),
        "regression P99": regressed(here, course.used),
        "regression at updates P99": regressed(here, course.used, renewed),
    }
    figures = {name: figures_of(here.truth, e, course.used, calibration_h)["P99"] for name, e in peers.items()}
    again = control(
        here, TalcSettings(method="models", control=settings, training=replace(TRAINING, static_inputs=False))
    )
    other = figures_of(here.truth, again.estimate, again.used, calibration_h)
    return {**figures, "inputs again P99": other["P99"], "inputs again measurements": other["measurements"]}


def _plainly_measured(calibration_h: float) -> dict[tuple[int, float], BoolArray]:
    """By the calibration's and the later interval, steps and hours: (T,) measured rows, without any no-good phase."""
    steps, rows = _steps(calibration_h), round(HOURS * 3600 / STEP_S)
    found = {}
    for every in (1, *_thinned(calibration_h)):
        for interval in INTERVAL_H if every == 1 else SPARSE_INTERVAL_H:
            used = np.zeros(rows, dtype=np.bool_)
            used[: steps + 1 : every] = True
            used[steps :: _steps(interval)] = True
            found[every, interval] = used
    return found


def _thinned(calibration_h: float) -> list[int]:
    """Steps between the measurements of a sparse calibration that is long enough for a training."""
    return [every for every in SPARSE if _steps(calibration_h) >= LEAST_CALIBRATION * every]


def _plain_name(every: int, interval_h: float) -> str:
    return f"regression each {interval_h:g} h{_after(every)}"


def _after(every: int) -> str:
    return "" if every == 1 else f", calibrated each {every * STEP_S / 60:.0f} min"


def _settings(chosen: Sequence[Any]) -> ControlSettings:
    """Settings of the set with this key: three lengths, or calibration and name."""
    if len(chosen) == 3:
        return _control(*chosen)
    named = {
        name + _after(every): settings
        for every in (1, *_thinned(chosen[0]))
        for kind in (_intervals, _policies)
        for name, settings in kind(chosen[0], every)
    }
    return named[chosen[1]]


def figures_of(truth: FloatArray, estimate: FloatArray, used: BoolArray, calibration_h: float) -> dict[str, float]:
    """P99 and RMSE of the six position errors together, µm; mean SMAPE of the nine, %; all after the calibration.

    Pd over the whole series including the calibration: otherwise a long calibration would cost nothing.
    """
    after = slice(_steps(calibration_h) + 1, None)
    left = (truth - estimate)[after]
    return {
        "P99": indicators.p99(left[:, POSITIONS]),
        "RMSE": indicators.rms(left[:, POSITIONS]),
        "SMAPE": float(
            np.mean([indicators.smape(t, e) for t, e in zip(truth[after].T, estimate[after].T, strict=True)])
        ),
        "Pd": indicators.productivity(int(used.sum()), CYCLE_S, len(used) * STEP_S),
        "measurements": int(used.sum()),
    }


def _steps(hours: float) -> int:
    return round(hours * 3600 / STEP_S)


def _control(calibration_h: float, interval_h: float, no_good: int, every: int = 1) -> ControlSettings:
    return ControlSettings(
        calibration_steps=_steps(calibration_h),
        calibration_interval_steps=every,
        measurement_interval_steps=_steps(interval_h),
        no_good_measurements=no_good,
        acl="fixed",
    )


def _intervals(calibration_h: float, every: int) -> list[tuple[str, ControlSettings]]:
    return [
        (f"each {interval:g} h, {no_good}", _control(calibration_h, interval, no_good, every))
        for interval in SPARSE_INTERVAL_H
        for no_good in SPARSE_NO_GOOD
    ]


def _policies(calibration_h: float, every: int) -> list[tuple[str, ControlSettings]]:
    """With names that say all that is varied: policy, share, shortest to longest interval, no-good measurements."""

    def one(policy: Literal["novelty", "uncertainty"], share: float, shortest: float) -> None:
        for longest in LONGEST_H:
            for no_good in POLICY_NO_GOOD:
                settings = ControlSettings(
                    calibration_steps=_steps(calibration_h),
                    calibration_interval_steps=every,
                    no_good_measurements=no_good,
                    acl="fixed",
                    policy=policy,
                    uncertainty_share=share,
                    shortest_interval_steps=_steps(shortest),
                    longest_interval_steps=_steps(longest),
                )
                title = f"uncertainty {share:g}" if policy == "uncertainty" else policy
                found.append((f"{title}, {shortest:g} to {longest:g} h, {no_good}", settings))

    found: list[tuple[str, ControlSettings]] = []
    for share in SHARES:
        one("uncertainty", share, SOONEST_H)
    for shortest in SHORTEST_H:
        one("novelty", 1.0, shortest)
    return found


STUDY = Study(
    "parameters",
    "Calibration length, measurement interval and relearning on four load cases",
    runs,
    run,
    report,
    then,
    learns=learns,
)
