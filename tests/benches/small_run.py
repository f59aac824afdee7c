"""A small run of a gateway, as its report sees it, with figures that can be computed by hand."""

from dataclasses import replace
from zoneinfo import ZoneInfo

import numpy as np

from gateway.reporting.data import CycleSeen, ReportData
from talc.frame import Phase

STEP_S = 300.0
START = 1_767_592_800.0
"""2026-01-05 06:00 UTC."""
ZURICH = ZoneInfo("Europe/Zurich")


def small_run(steps: int = 48, *, start: float = START) -> ReportData:
    """Each step is measured: EZ0A is +40 and -40 µm alternately and was predicted to a tenth; all else is zero.

    At the sphere that moves the tool only along Z: 40 µm RMS without compensation, 4 µm with it.
    """
    errors = np.zeros((steps, 9))
    errors[:, 1] = np.where(np.arange(steps) % 2, 40.0, -40.0)
    nothing = np.full((steps, 9), np.nan)
    k = np.arange(steps, dtype=np.int64) + int(start // STEP_S)
    return ReportData(
        machine="mill",
        fingerprint="f",
        versions="v",
        step_s=STEP_S,
        start_utc_s=start,
        k=k,
        phases=(Phase.COMPENSATION,) * steps,
        predicted=0.9 * errors,
        corrected=0.9 * errors,
        sigma=nothing,
        limits=nothing,
        measured=errors,
        models=(),
        events=(),
        compensation_s=np.asarray(np.arange(steps) * STEP_S, dtype=np.float64),
        compensation_um=np.zeros((steps, 3)),
        input_names=("front", "rear", "speed"),
        channel_health={"front": {"good": steps}, "rear": {"good": steps}},
        cycles=steps,
        rejected_cycles=0,
        truth=None,
        zone=ZURICH,
        noise=np.full(9, 0.5),
        inputs=np.column_stack([20.0 + np.arange(steps) * step for step in (0.1, 0.01, 1.0)]),
        input_units=("degC", "degC", ""),
        cycles_seen=tuple(CycleSeen(STEP_S * i, "") for i in range(0, steps, 4)),
        sphere_m=(0.12, 0.08),
    )


def with_gap(data: ReportData, after: int, steps: int) -> ReportData:
    """The same, but the gateway stood still for this many steps after one of them."""
    k = data.k.copy()
    k[after + 1 :] += steps
    return replace(data, k=k)
