"""Runs a controller on a recording as if it were live, and collects what the report shows."""

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np

from gateway.reporting.data import AdoptedModels, ReportData
from gateway.reporting.recordings.grid import Recording
from gateway.runtime.versions import versions
from talc.control import Controller
from talc.explanation import Reasons, Weights
from talc.frame import Decision, Event, FloatArray, Frame, IntArray, Measurement
from talc.learner import Prior
from talc.models import ErrorModel
from talc.names import THERMAL_ERRORS
from talc.papers.training import train
from talc.settings import TalcSettings

_ERRORS = len(THERMAL_ERRORS)


def rehearse_recording(
    recording: Recording,
    settings: TalcSettings,
    *,
    prior: Prior | None = None,
    every_measurement: bool = False,
    explained: bool = False,
    progress: Callable[[int], None] = lambda _: None,
) -> ReportData:
    """Run every step of the recording through a fresh controller; a training ends within its step.

    A recorded measurement reaches the controller if it has requested one, as a probing cycle would; the others only
    judge. every_measurement: all of them reach it. explained: with the contributions and weights of the learner's
    inputs. Sensors are not compared with each other and measurements are not checked, because a recording contains
    neither units nor the centres of a probing cycle.
    """
    controller = Controller(recording.input_names, settings, recording.step_s, prior)
    decisions: list[Decision] = []
    used = np.full((len(recording.k), _ERRORS), np.nan)
    estimate, held = np.full((len(recording.k), _ERRORS), np.nan), np.full((len(recording.k), _ERRORS), np.nan)
    in_force, last, asked = np.full(_ERRORS, np.nan), np.full(_ERRORS, np.nan), True
    models: list[AdoptedModels] = []
    parts: list[FloatArray] = []
    events = []
    for row, k in enumerate(recording.k.tolist()):
        inputs, errors = recording.inputs[row], recording.errors[row]
        measurement = None
        if (asked or every_measurement) and np.isfinite(errors).any():
            measurement = Measurement(errors, np.full(_ERRORS, np.nan))
            used[row] = errors
        begins = k in recording.restarts
        if anew := begins and recording.zero_each_run:
            last, in_force = np.where(np.isfinite(last), 0.0, last), np.where(np.isfinite(in_force), 0.0, in_force)
        decision = controller.step(Frame(k, inputs, np.isfinite(inputs), measurement, begins, new_reference=anew))
        # The offsets on the control before this step's measurement: an error without a model is held.
        estimate[row] = np.where(np.isfinite(decision.predicted), decision.predicted, in_force)
        held[row] = last
        in_force, asked = decision.corrected, decision.measure is not None
        last = np.where(np.isfinite(used[row]), used[row], last)
        at = (k - int(recording.k[0])) * recording.step_s
        events += [(at, event) for event in decision.events]
        if decision.training is not None:
            found = train(decision.training)
            events += [(at, event) for event in controller.adopt(found)]
            models.append(AdoptedModels(k, found))
        if explained and (why := controller.explain()) is not None:
            parts.append(np.column_stack([why.inputs, why.level]))
        decisions.append(decision)
        progress(row + 1)
    good = np.isfinite(recording.inputs).sum(axis=0)
    return ReportData(
        machine=recording.name,
        fingerprint="",
        versions=versions(),
        step_s=recording.step_s,
        start_utc_s=recording.start_utc_s,
        k=recording.k,
        phases=tuple(d.phase for d in decisions),
        predicted=estimate,
        corrected=np.array([d.corrected for d in decisions]),
        sigma=np.array([d.sigma for d in decisions]),
        limits=np.array([d.limits for d in decisions]),
        measured=used,
        models=tuple(models),
        events=tuple((at, _named(event, recording.labels)) for at, event in events),
        compensation_s=np.empty(0),
        compensation_um=np.empty((0, 3)),
        input_names=recording.input_names,
        channel_health={
            name: {"good": int(g), **({"no_value": len(recording.k) - int(g)} if g < len(recording.k) else {})}
            for name, g in zip(recording.input_names, good, strict=True)
        },
        cycles=int(np.isfinite(used).any(axis=1).sum()),
        rejected_cycles=0,
        truth=None,
        recorded=recording.errors,
        held=held,
        trusted=np.array([d.trusted for d in decisions]),
        reasons=controller.reasons(),
        labels=recording.labels,
        asked=tuple("" if d.measure is None else d.measure.value for d in decisions),
        contributions=np.array(parts) if parts else None,
        weights=controller.weights() if explained else None,
        inputs=np.where(np.isfinite(recording.inputs), recording.inputs, np.nan),
        moved=_moved(controller.reasons(), recording.input_names),
        shifts=(),
        origin_s=recording.origin_s,
        compared=False,
    )


_MODEL_COLUMNS = (
    "error", "k", "part", "input", "time_constant_s", "delay_s", "weight", "sigma", "reference", "share",
)  # fmt: skip


def learnt_columns(data: ReportData) -> dict[str, Sequence[object]]:
    """What was learnt of a recording, a row per weight, as columns; of the errors that it has.

    error: its name. k: the step after which it was known: the last one with the learner, the step of each adoption with
    trained models. part: `level`, `smooth` (what is not linear, then), `input`, or `past` (of the error itself). A
    correction is share · (sum of weight · (value - reference)), where the value of level and smooth is 1 and their
    reference 0, and other values come through a first-order lag of `time_constant_s`, or from `delay_s` ago. sigma:
    standard uncertainty of the weight by itself, of the learner only. Weights are in µm or µm/m per unit of their
    input. A trained model's bounds and disturbance are not among them.
    """
    rows: list[tuple[object, ...]] = []
    for e in _errors_of(data).tolist():
        if data.weights is not None:
            rows += _learnt(data, data.weights, e)
        for adopted in data.models:
            model = adopted.models.models[e]
            if model is not None:
                rows += _trained(model, data.labels[e], adopted.after_k, data.step_s)
    return {name: [row[i] for row in rows] for i, name in enumerate(_MODEL_COLUMNS)}


def _learnt(data: ReportData, known: Weights, e: int) -> list[tuple[object, ...]]:
    error, k, share, none = data.labels[e], int(data.k[-1]), float(known.share[e]), math.nan
    level = (error, k, "level", "", none, none, float(known.level[e]), float(known.level_sigma[e]), 0.0, share)
    smooth = (error, k, "smooth", "", none, none, float(known.smooth[e]), none, 0.0, share)
    inputs = [
        (error, k, "input", name, lag, none, float(weight), float(sigma), float(reference), share)
        for name, weights, sigmas, reference in zip(
            data.input_names, known.inputs[e], known.inputs_sigma[e], known.reference, strict=True
        )
        for lag, weight, sigma in zip(known.time_constants_s, weights, sigmas, strict=True)
    ]
    return [level, smooth, *inputs]


def _trained(model: ErrorModel, error: str, k: int, step_s: float) -> list[tuple[object, ...]]:
    none = math.nan
    constant = model.y_mean + model.y_std * model.intercept
    level = (error, k, "level", "", none, none, constant, none, 0.0, 1.0)
    past = [
        (error, k, "past", "", none, i * step_s, -float(a), none, model.y_mean, 1.0) for i, a in enumerate(model.a, 1)
    ]
    inputs = [
        (error, k, "input", name, none, j * step_s, float(b) * model.y_std / float(std), none, float(mean), 1.0)
        for name, weights, mean, std in zip(model.inputs, model.b, model.u_mean, model.u_std, strict=True)
        for j, b in enumerate(weights)
    ]
    return [level, *past, *inputs]


def _errors_of(data: ReportData) -> IntArray:
    """Places of the errors that a recording has."""
    recorded = data.measured if data.recorded is None else data.recorded
    return np.flatnonzero(np.isfinite(recorded).any(axis=0))


def _moved(reasons: Reasons | None, names: Sequence[str]) -> FloatArray | None:
    """(9, n) the magnitude by which each input moves each error, as of the last step."""
    if reasons is None:
        return None
    now = [dict(reason.inputs) for reason in reasons.errors]
    return np.array([[abs(of.get(name, 0.0)) for name in names] for of in now])


_OF_A_STEP = ("time", "k", "phase", "wanted")
_OF_AN_ERROR = ("predicted", "corrected", "sigma", "measured")


def column_named_twice(errors: Sequence[str], inputs: Sequence[str]) -> str | None:
    """A name that two columns of `columns_of` would have with these errors and inputs; None: each has its own."""
    names = Counter(_OF_A_STEP)
    for error in errors:
        parts = (*_OF_AN_ERROR, "trusted", *(f"from_{name}" for name in inputs), "level")
        names.update((error, *(f"{error}_{part}" for part in parts)))
    return next((name for name, count in names.items() if count > 1), None)


def columns_of(data: ReportData) -> dict[str, Sequence[object]]:
    """What came of a recording, a row per step, as columns; of the errors that it has.

    `E` as recorded, `E_predicted` before the step's measurement, `E_corrected` after it, `E_sigma` its standard
    uncertainty, `E_measured` where it was used as a measurement, `E_trusted` whether it is corrected; with
    contributions `E_from_INPUT` and `E_level`, which add up to `E_corrected`. `time` is UTC in ISO 8601, or seconds as
    the recording counts them if it has no dates.
    """
    seconds = (data.start_utc_s + data.time_s).tolist()
    of_a_step: tuple[Sequence[object], ...] = (
        [datetime.fromtimestamp(t, UTC).isoformat() for t in seconds] if data.origin_s is None else seconds,
        data.k.tolist(),
        [phase.value for phase in data.phases],
        data.asked,
    )
    columns = dict(zip(_OF_A_STEP, of_a_step, strict=True))
    recorded = data.measured if data.recorded is None else data.recorded
    for e in _errors_of(data).tolist():
        error = data.labels[e]
        columns[error] = recorded[:, e].tolist()
        for name in _OF_AN_ERROR:
            columns[f"{error}_{name}"] = getattr(data, name)[:, e].tolist()
        if data.trusted is not None:
            columns[f"{error}_trusted"] = data.trusted[:, e].tolist()
        if data.contributions is not None:
            parts = data.contributions[:, e]
            for i, name in enumerate(data.input_names):
                columns[f"{error}_from_{name}"] = parts[:, i].tolist()
            columns[f"{error}_level"] = parts[:, -1].tolist()
    return columns


def _named(event: Event, labels: Sequence[str]) -> Event:
    """With the recording's name of the error: the controller knows its places by the nine names."""
    if event.error is None:
        return event
    label = labels[THERMAL_ERRORS.index(event.error)]
    return replace(event, error=label, text=event.text.replace(event.error, label, 1))
