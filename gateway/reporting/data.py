"""The data of a report, as arrays."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, time, tzinfo
from types import MappingProxyType
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gateway.model.text import Language, Value
from gateway.reporting.local import local_moment, since
from talc.explanation import Reasons, Weights
from talc.frame import BoolArray, Event, EventKind, FloatArray, Phase
from talc.models import ModelSet
from talc.names import THERMAL_ERRORS


@dataclass(frozen=True, slots=True)
class AdoptedModels:
    """Models, and the grid index of the frame after which they were adopted."""

    after_k: int
    models: ModelSet


TRUTH_WIDTH = 17
"""Columns of a simulated truth: UTC, nine errors, tool deviation without and with compensation, probing."""


@dataclass(frozen=True, slots=True)
class Truth:
    """Data that only a simulation has."""

    time_s: FloatArray
    """(S,) since the first frame."""
    errors: FloatArray
    """(S, 9)"""
    uncompensated_um: FloatArray
    """(S, 3) tool to workpiece, X Y Z."""
    compensated_um: FloatArray
    """(S, 3) the same with the offsets in force on the control."""
    probing: BoolArray
    """(S,) whether the machine probed: nothing was cut and the offsets stood still."""

    @classmethod
    def of(cls, rows: FloatArray, start_utc_s: float) -> "Truth":
        """From (S, TRUTH_WIDTH) rows of the emulated machine, whose times are UTC seconds."""
        return cls(
            time_s=rows[:, 0] - start_utc_s,
            errors=rows[:, 1:10],
            uncompensated_um=rows[:, 10:13],
            compensated_um=rows[:, 13:16],
            probing=rows[:, 16] > 0,
        )


WORK_SHIFTS = (time(6), time(14), time(22))
"""When shifts begin, unless the reader says otherwise."""


@dataclass(frozen=True, slots=True)
class CycleSeen:
    """One probing request that has ended."""

    ended_s: float
    """Since the first frame."""
    refused: str
    """Why its result was not used; empty: it was."""
    cycles: int = 1
    """How many ran one after the other: several for the reference."""
    lasted_s: float = math.nan
    """From the request to its end; NaN: unknown."""


CYCLE_S = 120.0
"""Duration of a probing cycle of which none has been timed (Z22)."""


def cycle_s(cycles: Sequence[CycleSeen]) -> float:
    """The median duration of one cycle, of those whose result was used."""
    timed = [each.lasted_s / each.cycles for each in cycles if not each.refused and each.lasted_s > 0.0]
    return float(np.median(timed)) if timed else CYCLE_S


def probing_s(cycles: Sequence[CycleSeen], one_s: float) -> float:
    """How long the machine probed. A refused request counts as no more than a cycle: it may have waited in vain.

    one_s: median duration of a cycle
    """
    usual = [one_s * each.cycles for each in cycles]
    own = [each.lasted_s if each.lasted_s > 0.0 else of for each, of in zip(cycles, usual, strict=True)]
    return sum(min(s, of) if each.refused else s for each, s, of in zip(cycles, own, usual, strict=True))


class NotYet(NamedTuple):
    """One thing without which a gateway cannot learn."""

    key: str
    """Of the catalogue's `report_missing` for what it is, and of `report_then` for what to do, or what comes by itself.
    """
    values: Mapping[str, Value] = MappingProxyType({})

    def written(self, said: Language) -> tuple[str, str]:
        """What is missing; and what to do, or what will happen by itself."""
        what, then = (said(f"{group}.{self.key}", **self.values) for group in ("report_missing", "report_then"))
        return what, then


@dataclass(frozen=True, slots=True)
class ReportData:
    """One run. T frames, M steps of the compensation; µm and µm/m."""

    machine: str
    fingerprint: str
    versions: str
    step_s: float
    start_utc_s: float
    """UTC seconds of the first frame."""
    k: np.ndarray[tuple[int], np.dtype[np.int64]]
    phases: tuple[Phase, ...]
    predicted: FloatArray
    corrected: FloatArray
    sigma: FloatArray
    limits: FloatArray
    measured: FloatArray
    """(T, 9) each"""
    models: tuple[AdoptedModels, ...]
    events: tuple[tuple[float, Event], ...]
    """Seconds since the first frame, and what happened."""
    compensation_s: FloatArray
    compensation_um: FloatArray
    """(M,), (M, 3)"""
    input_names: tuple[str, ...]
    channel_health: Mapping[str, Mapping[str, int]]
    """Channel to the number of readings of each quality."""
    cycles: int
    rejected_cycles: int
    truth: Truth | None
    recorded: FloatArray | None = None
    """(T, 9) all measurements in a recording, requested or not; None: a run of a gateway."""
    held: FloatArray | None = None
    """(T, 9) the last measurements used before this step; only for a recording."""
    compared: bool = True
    """Whether the temperature sensors were compared with each other."""
    trusted: BoolArray | None = None
    """(T, 9) whether the error is corrected; None: unknown, from an earlier program."""
    reasons: Reasons | None = None
    """The latest reasons of a learner."""
    labels: tuple[str, ...] = THERMAL_ERRORS
    """(9,) names of the errors; a recording may have others."""
    asked: tuple[str, ...] = ()
    """(T,) why a measurement was wanted for the next step; empty: not. Only for a recording."""
    contributions: FloatArray | None = None
    """(T, 9, n + 1) what each input adds to `corrected`, and at last what no input explains; of a learner, if asked."""
    weights: Weights | None = None
    """What a learner knew after the last step; only for a recording."""
    made: tuple[tuple[str, str], ...] = ()
    """What is needed to make the page of a recording again: names and texts."""
    zone: tzinfo = UTC
    """Time zone of all times that are shown."""
    shifts: tuple[time, ...] = WORK_SHIFTS
    """When shifts begin, local time."""
    noise: FloatArray | None = None
    """(9,) standard uncertainty of one measurement; NaN or None: unknown."""
    inputs: FloatArray | None = None
    """(T, n); NaN: no good value."""
    input_units: tuple[str, ...] = ()
    """(n,) `degC` and others; empty text: unknown."""
    moved: FloatArray | None = None
    """(9, n) mean magnitude by which each input moved each error, of the learner's reasons; None: there are none."""
    cycles_seen: tuple[CycleSeen, ...] = ()
    """Every probing request, oldest first; of a recording none, because nothing is known of its machine."""
    stale: BoolArray | None = None
    """(M,) steps of the compensation without a usable prediction; None: unknown."""
    sphere_m: tuple[float, float] | None = None
    """Radius and height of the probing sphere, where the errors are seen at the tool; None: not a five-axis run."""
    mode: str = "compensate"
    """Mode of the compensation; another one writes nothing to the control."""
    not_yet: tuple[NotYet, ...] = ()
    """Why nothing has been learnt; empty: something has."""
    health_of: Literal["readings", "steps"] = "readings"
    """What `channel_health` counts."""
    language: str = "en"
    """Of the catalogue."""
    tolerance_um: float | None = None
    """Of the jobs; None: nobody has said."""
    instruments: tuple[tuple[str, str, str, str], ...] = ()
    """What measures: what it is, its serial number, when it was calibrated, and when it is due; empty: unknown."""
    source: str = ""
    """SHA-256 of the database's file; empty: not asked for."""
    origin_s: float | None = None
    """Time of the first row of a recording without dates, on the clock of `start_utc_s`; times count from it. None:
    UTC."""

    @property
    def time_s(self) -> FloatArray:
        """(T,) seconds since the first frame."""
        return np.asarray((self.k - self.k[0]) * self.step_s, dtype=np.float64)

    def moment(self, seconds: float) -> str:
        """Local time of seconds since the first frame; hours since the first row of a recording without dates."""
        if self.origin_s is not None:
            return since(self.start_utc_s - self.origin_s + seconds)
        return local_moment(self.start_utc_s + seconds, self.zone, Language(self.language))

    def rows_at(self, time_s: FloatArray) -> NDArray[np.intp]:
        """(m,) row of the latest step at or before each instant; -1 before the first."""
        return np.searchsorted(self.time_s, time_s, side="right") - 1

    @property
    def truth_ran(self) -> BoolArray:
        """(S,) the truth's instants before the last decision: a demo's gateway stops then, and its machine goes on."""
        if self.truth is None:
            raise ValueError("data.truth is None")
        return np.asarray(self.truth.time_s < self.time_s[-1])

    @property
    def judged_from(self) -> int | None:
        """Row of the first decision after `calibration`, when corrections began; None if they never did."""
        rows = [i for i, phase in enumerate(self.phases) if phase is not Phase.CALIBRATION]
        return rows[0] if rows else None

    def count(self, kind: EventKind) -> int:
        """Events of a kind."""
        return sum(event.kind is kind for _, event in self.events)
