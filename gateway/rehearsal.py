"""Runs a controller on a recording as if it were live, and collects what the report shows."""

from collections.abc import Callable

import numpy as np

from gateway.recordings import Recording
from gateway.report import AdoptedModels, ReportData
from gateway.versions import versions
from talc.control import Controller
from talc.frame import Decision, Frame, Measurement
from talc.learner import Prior
from talc.names import THERMAL_ERRORS
from talc.settings import TalcSettings
from talc.training import train

_ERRORS = len(THERMAL_ERRORS)


def rehearse(
    recording: Recording,
    settings: TalcSettings,
    *,
    prior: Prior | None = None,
    every_measurement: bool = False,
    progress: Callable[[int], None] = lambda _: None,
) -> ReportData:
    """Run every step of the recording through a fresh controller; a training ends within its step.

    A recorded measurement reaches the controller if it has requested one, as a probing cycle would; the others only
    judge. every_measurement: all of them reach it. Sensors are not compared with each other and measurements are not
    checked, because a recording contains neither units nor the centres of a probing cycle.
    """
    controller = Controller(recording.input_names, settings, recording.step_s, prior)
    decisions: list[Decision] = []
    used = np.full((len(recording.k), _ERRORS), np.nan)
    estimate, held = np.full((len(recording.k), _ERRORS), np.nan), np.full((len(recording.k), _ERRORS), np.nan)
    in_force, last, asked = np.full(_ERRORS, np.nan), np.full(_ERRORS, np.nan), True
    models: list[AdoptedModels] = []
    events = []
    for row, k in enumerate(recording.k.tolist()):
        inputs, errors = recording.inputs[row], recording.errors[row]
        measurement = None
        if (asked or every_measurement) and np.isfinite(errors).any():
            measurement = Measurement(errors, np.full(_ERRORS, np.nan))
            used[row] = errors
        decision = controller.step(Frame(k, inputs, np.isfinite(inputs), measurement))
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
        events=tuple(events),
        compensation_s=np.empty(0),
        compensation_um=np.empty((0, 3)),
        input_names=recording.input_names,
        channel_health={
            name: {"good": int(g), **({"missing": len(recording.k) - int(g)} if g < len(recording.k) else {})}
            for name, g in zip(recording.input_names, good, strict=True)
        },
        cycles=int(np.isfinite(used).any(axis=1).sum()),
        rejected_cycles=0,
        truth=None,
        recorded=recording.errors,
        held=held,
        trusted=np.array([d.trusted for d in decisions]),
        reasons=controller.reasons(),
        not_compared="a recording does not say which of its inputs are temperatures",
    )
