"""Forecasts of the inputs under each planned load of the configuration, by how they have followed loads so far."""

import asyncio
import logging
from collections.abc import Callable, Mapping, Sequence
from typing import Final

import numpy as np

from gateway.control.last_rows import LastRows
from gateway.model.codes import NoticeCode
from gateway.model.text import Text
from gateway.runtime.clocks import ServiceClock
from gateway.runtime.problems import Problems
from talc.frame import BoolArray, Decision, FloatArray, Frame, Frames
from talc.load_heat import HISTORY_S
from talc.planned import LoadResponse, learn_response
from talc.steps import DAY_S, steps_in

log = logging.getLogger(__name__)

_SUBJECT = "planned loads"
_SPINDLE: Final = "spindle"
"""In the names of its loads."""

_MEMORY_S: Final = 14.0 * DAY_S
_MOST_ROWS: Final = 40_320
"""Two weeks at 30 s; with a shorter grid step less. 36 inputs take 13 MB, and learning a few times that."""
_LEARN_EVERY_S: Final = DAY_S
_LEARN_FIRST_S: Final = 2.0 * DAY_S


def rows_remembered(step_s: float) -> int:
    """The most frames of this grid step from which is learnt."""
    return min(steps_in(_MEMORY_S, step_s), _MOST_ROWS)


class PlannedLoads:
    """Keeps the frames of two weeks, learns once a day how inputs follow loads, and applies it to the planned loads.

    Parameters
    ----------
    input_names: order of a frame's inputs
    step_s: of the grid
    planned: by name, loads and their values in their own units; without any, and without a state of the spindle, it
        does nothing
    is_load: whether an input is a load that heats
    clock: stands still while it learns
    before: frames of an earlier run
    """

    def __init__(
        self,
        input_names: Sequence[str],
        step_s: float,
        planned: Mapping[str, Mapping[str, float]],
        is_load: Callable[[str], bool],
        clock: ServiceClock,
        before: Frames | None = None,
    ) -> None:
        self._names, self._planned, self._is_load, self._clock = tuple(input_names), dict(planned), is_load, clock
        self._learns = bool(planned) or any(_SPINDLE in name and is_load(name) for name in self._names)
        self._step_s = step_s
        self._learn_every, self._learn_first = steps_in(_LEARN_EVERY_S, step_s), steps_in(_LEARN_FIRST_S, step_s)
        self._rows = LastRows(len(self._names), rows_remembered(step_s))
        self._last_k: int | None = None
        self._learnt_k: int | None = None
        self._response: LoadResponse | None = None
        self._due = asyncio.Event()
        self._problems = Problems(clock, _LEARN_EVERY_S, lambda _: None, log)
        if before is not None and self._learns:
            for k, inputs, valid in zip(before.k.tolist(), before.inputs, before.valid, strict=True):
                self._append(k, inputs, valid)

    def follow(self, frame: Frame, _: Decision | None = None) -> None:
        """Take a frame; returns at once."""
        if not self._learns:
            return
        self._append(frame.k, frame.inputs, frame.valid)
        if len(self._rows) >= self._learn_first and (
            self._learnt_k is None or frame.k - self._learnt_k >= self._learn_every
        ):
            self._learnt_k = frame.k
            self._due.set()

    async def run(self) -> None:
        """Learn whenever it is due, until cancelled."""
        while True:
            await self._due.wait()
            self._due.clear()
            with self._clock.hold():
                await self.learn()

    async def learn(self) -> None:
        """How the inputs follow the loads, from the frames so far."""
        loads = [name for name in self._names if self._is_load(name)]
        inputs, valid = self._rows.part(slice(None))
        try:
            self._response = await asyncio.to_thread(learn_response, self._names, inputs, valid, loads, self._step_s)
        except Exception as error:  # noqa: BLE001 - advice must not endanger the gateway
            self._problems.report(_SUBJECT, Text(NoticeCode.LOADS_NOT_LEARNT), type(error).__name__, bug=error)
        else:
            self._problems.clear(_SUBJECT, NoticeCode.LOADS_LEARNT)

    def changes(self, steps: int) -> dict[str, FloatArray | None]:
        """By planned load, (steps, n) by how much the inputs will differ from the last frame's at each later step.

        None: it is not known yet what this load does.
        """
        response = self._response
        if response is None:
            return dict.fromkeys(self._planned)
        inputs, valid = self._rows.part(slice(-steps_in(HISTORY_S, self._step_s), None))
        return {
            name: response.changes(self._names, inputs, valid, loads, steps) for name, loads in self._planned.items()
        }

    def during(self, loads: Mapping[str, float], lasting: int, steps: int) -> FloatArray | None:
        """(steps, n) the same for loads that run for `lasting` steps, and are then again as they are now."""
        inputs, valid = self._rows.part(slice(-steps_in(HISTORY_S, self._step_s), None))
        if self._response is None or not len(inputs):
            return None
        return self._response.changes(self._names, inputs, valid, loads, steps, lasting)

    def of(self, planned: str) -> dict[str, float]:
        """The loads of a planned load, by its name. Without a name, those of the spindle as they usually run: the
        median of what they were while they ran. Raises ValueError naming what there is."""
        if planned:
            if planned not in self._planned:
                there = ", ".join(self._planned) or "none is configured"
                raise ValueError(f"load = {planned!r}: expected the name of a planned load ({there})")
            return dict(self._planned[planned])
        inputs, valid = self._rows.part(slice(None))
        found = {}
        for i, name in enumerate(self._names):
            if _SPINDLE in name and self._is_load(name):
                size = np.abs(inputs[valid[:, i], i])
                if (runs := size[size > 0.0]).size:
                    found[name] = float(np.median(runs))
        return found

    def _append(self, k: int, inputs: FloatArray, valid: BoolArray) -> None:
        if self._last_k is not None:
            self._rows.append_gap(k - self._last_k - 1)
        self._rows.append(inputs, valid)
        self._last_k = k
