"""Makes frames on the common grid from readings at their own times. Pure: time is an argument."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime

import numpy as np
from numpy.typing import NDArray

from drivers.base import Reading
from talc.frame import BoolArray, FloatArray, Frame, Measurement

_BELIEVED_S = 366 * 86400.0
_RECENT = 0.35
"""Share of a step in which a part must end to count as recent: long enough to average noise, and so short that a mean
hardly lags behind. Of ten parts these are the latest four."""
_FEWEST = 0.2
"""Share of a step's readings: if fewer are recent, the input is failing, and its last readings are those most often
wrong."""


@dataclass(frozen=True, slots=True)
class Instant:
    """The end of one grid step."""

    k: int
    monotonic_s: float
    """When it is reached on the monotonic clock."""
    clock_moved_s: float = 0.0
    """How far UTC had moved against the monotonic clock when the grid was re-anchored; otherwise 0."""
    known: bool = True
    """Whether UTC was known to be right when the instant was numbered."""
    lead_s: float = 0.0
    """How far the numbering is ahead of UTC."""


class Schedule:
    """Grid instants on the monotonic clock, numbered by UTC.

    Between instants only the monotonic clock counts. When UTC has moved against it by more than half a step (NTP
    synchronised, or somebody set the clock), the grid is re-anchored: forward leaves a gap in k; backward continues
    with the next index, because k must increase. From then on, restarts included, the numbering is ahead of UTC by as
    much (`lead_s`), so that differences of k stay true. A UTC that is not known to be right changes no lead, and is not
    believed when it is more than a year after the last frame.

    Parameters
    ----------
    step_s: grid step, s, > 0
    last_k: index of the last stored frame, so that a restart with a slow clock never repeats one
    lead_s: how far the stored numbering is ahead of UTC
    """

    def __init__(self, step_s: float, last_k: int | None = None, lead_s: float = 0.0) -> None:
        if not (math.isfinite(step_s) and step_s > 0):
            raise ValueError(f"step_s = {step_s!r}: expected a positive number")
        self._step = step_s
        self._last_k = last_k
        self._lead_s = lead_s
        self._known = True
        self._anchor_s: float | None = None
        """Seconds of the numbering minus monotonic seconds, as used for the grid."""
        self._seen_s = 0.0
        """UTC seconds minus monotonic seconds, as last seen."""

    @property
    def step_s(self) -> float:
        """Grid step, s."""
        return self._step

    def next(self, utc: datetime, monotonic_s: float, *, known: bool = True) -> Instant:
        """The next instant after now. Call it once per step, because it counts the instant as used.

        known: whether UTC is known to be right
        """
        offset = utc.timestamp() - monotonic_s
        wanted = offset + self._lead_s
        moved = 0.0 if self._anchor_s is None else offset - self._seen_s
        again = self._anchor_s is None or self.moved(utc, monotonic_s)
        if self._anchor_s is not None and known and not self._known:
            again = again or abs(wanted - self._anchor_s) > self._step / 2
        anchor = wanted if self._anchor_s is None or again else self._anchor_s
        self._seen_s, self._known = offset, known
        k = math.floor((monotonic_s + anchor) / self._step) + 1
        absurd = again and not known and self._absurd(k)
        if self._last_k is not None and (k <= self._last_k or absurd):
            behind_s = self._last_k * self._step - monotonic_s - anchor
            if absurd or (again and behind_s > self._step / 2):  # number on from the last frame, on the same instants
                anchor += (self._last_k + 1 - k) * self._step
                self._lead_s = anchor - offset if known else self._lead_s
            k = self._last_k + 1
        self._anchor_s, self._last_k = anchor, k
        return Instant(k, k * self._step - anchor, moved if again else 0.0, known, self._lead_s)

    def moved(self, utc: datetime, monotonic_s: float) -> bool:
        """Whether UTC has moved against the monotonic clock, by more than half a step, since the last instant."""
        return self._anchor_s is not None and abs(utc.timestamp() - monotonic_s - self._seen_s) > self._step / 2

    def _absurd(self, k: int) -> bool:
        return self._last_k is not None and (k - self._last_k) * self._step > _BELIEVED_S


@dataclass(frozen=True, slots=True)
class _Sums:
    """What was read in a part of a step."""

    end_s: float
    count: NDArray[np.int64]
    """(n,) usable readings of each input; `total` (n,) their sums."""
    total: FloatArray


class GridSampler:
    """Collects the readings of a step and makes a frame of them.

    An input's number is the mean of its usable readings in the step that ends at the frame's instant; without one it is
    NaN and not valid. The mean is used, not the last reading, because it averages noise and quantisation of
    temperatures, and turns a machine state such as the cutting fluid into the share of the step in which it was on.

    Parameters
    ----------
    input_names: order of the frame's inputs
    step_s: grid step, s; older readings are dropped when a frame comes late
    tolerance_state: the machine state that is the stated tolerance; None: none is
    """

    def __init__(self, input_names: Sequence[str], step_s: float, tolerance_state: str | None = None) -> None:
        self._step, self._tolerance_state = step_s, tolerance_state
        self._tolerance_um: float | None = None
        self._index = {name: position for position, name in enumerate(input_names)}
        if len(self._index) != len(input_names):
            raise ValueError(f"input_names = {tuple(input_names)!r}: a name occurs twice")
        self._samples: list[tuple[int, float, float]] = []
        """(input, monotonic seconds, value) not yet in a part."""
        self._parts: list[_Sums] = []
        """The parts of the last step."""
        self._framed_s = -math.inf
        """The instant of the last frame."""

    def add(self, readings: Iterable[Reading]) -> None:
        """Take readings; those of unusable quality, and those of channels that are not inputs, are ignored."""
        for reading in readings:
            position = self._index.get(reading.channel)
            if position is not None and reading.quality.usable and math.isfinite(reading.value):
                self._samples.append((position, reading.monotonic_s, reading.value))

    def add_states(self, states: Mapping[str, float], monotonic_s: float) -> None:
        """Take machine states read from the NC at `monotonic_s`; states that are not inputs are ignored."""
        self._tolerance_um = states.get(self._tolerance_state or "", self._tolerance_um)
        for name, value in states.items():
            position = self._index.get(name)
            if position is not None and math.isfinite(value):
                self._samples.append((position, monotonic_s, value))

    def present(self, now_s: float) -> tuple[FloatArray, BoolArray]:
        """(n,) inputs and whether they are valid: means of the recent parts of a step, one of which ends now. If hardly
        anything is recent, those of the last step.

        The next frame is as without this call. Calls must not go back in time.
        """
        self._add_up(now_s)
        recent, count = self._means(now_s - _RECENT * self._step)
        whole, of_step = self._means(now_s - self._step)
        return np.where(count > _FEWEST * of_step, recent, whole), of_step > 0

    def frame(
        self,
        instant: Instant,
        measurement: Measurement | None = None,
        *,
        pause_unknown: bool = False,
        new_reference: bool = False,
    ) -> Frame:
        """The frame of the step that ends at `instant`, with the latest stated tolerance. Later readings stay for the
        next one."""
        since_s = self._add_up(instant.monotonic_s)
        self._framed_s = instant.monotonic_s
        inputs, count = self._means(since_s)
        return Frame(instant.k, inputs, count > 0, measurement, pause_unknown, new_reference, self._tolerance_um)

    def _add_up(self, until_s: float) -> float:
        """Make one part of the readings of this step. Returns the time after which they were read: older ones are
        dropped."""
        since_s = max(until_s - self._step, self._framed_s)
        part = _Sums(until_s, np.zeros(len(self._index), dtype=np.int64), np.zeros(len(self._index)))
        later: list[tuple[int, float, float]] = []
        for sample in self._samples:
            position, at, value = sample
            if at > until_s:
                later.append(sample)
            elif at > since_s:
                part.count[position] += 1
                part.total[position] += value
        self._samples = later
        self._parts = [*(earlier for earlier in self._parts if earlier.end_s > until_s - self._step), part]
        return since_s

    def _means(self, since_s: float) -> tuple[FloatArray, NDArray[np.int64]]:
        """(n,) means of the parts that ended after that, NaN without a reading, and the number of their readings."""
        used = [part for part in self._parts if part.end_s > since_s]
        count = np.sum([part.count for part in used], axis=0)
        total = np.sum([part.total for part in used], axis=0)
        return np.divide(total, count, out=np.full(len(total), np.nan), where=count > 0), count
