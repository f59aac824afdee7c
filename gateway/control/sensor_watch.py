"""Checks whether the sensors still agree with each other: learns once a day, judges once an hour, reports once."""

import asyncio
import logging
import math
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass

from gateway.control.last_rows import LastRows
from gateway.model.codes import NoticeCode
from gateway.model.events import EventReported, SensorsJudged, Sink
from gateway.model.notice import Notice
from gateway.model.text import Text, failure
from gateway.model.wording import event_of, finding_text, problem_event
from gateway.runtime.clocks import ServiceClock
from gateway.runtime.problems import Problems
from gateway.runtime.workers.process import WorkError, in_process
from talc.frame import BoolArray, Decision, Event, EventKind, FloatArray, Frame, Frames
from talc.sensor_check import Finding, judge, rows_needed
from talc.sensor_model import SensorModel, learn
from talc.settings import SensorCheckSettings
from talc.steps import DAY_S, HOUR_S, steps_in

log = logging.getLogger(__name__)

_JUDGE_EVERY_S = HOUR_S
"""Or each window, if that is shorter: no row goes unjudged."""
_LEARN_EVERY_S = DAY_S
_LEARN_FIRST_S = DAY_S
"""Less does not show how the hall temperature varies."""

_LEAST_TEMPERATURES = 3
_MOST_IN_A_THREAD = 64
"""Largest number of temperatures; the work grows with its square, and more would delay the buses."""

Learn = Callable[
    [Sequence[str], FloatArray, BoolArray, SensorCheckSettings, Sequence[str], float], Awaitable[SensorModel | None]
]


@dataclass(slots=True)
class _KnownFinding:
    """A finding that still holds."""

    finding: Finding
    first: int
    last: int
    """Numbers of judgements."""
    first_k: int
    told: bool = False

    def is_about(self, finding: Finding) -> bool:
        """Among sensors side by side, now one is the most likely and now another."""
        mine = {*self.finding.inputs, *self.finding.alternatives}
        return finding.kind == self.finding.kind and not mine.isdisjoint({*finding.inputs, *finding.alternatives})


@dataclass(frozen=True, slots=True, eq=False)
class SeenBefore:
    """Frames and findings of an earlier run."""

    frames: Frames
    suspect_since_k: int | None
    """When the findings that still held were first reported."""


async def _learn_apart(
    names: Sequence[str],
    inputs: FloatArray,
    valid: BoolArray,
    settings: SensorCheckSettings,
    loads: Sequence[str],
    step_s: float,
) -> SensorModel | None:
    return await in_process(learn, names, inputs, valid, settings, loads, step_s)


class SensorWatch:
    """Keeps the last frames and compares them with what it learnt from earlier ones.

    An exchange is reported after half a window, an offset after a whole one; both end when a whole window has passed
    without them. Nothing is learnt from frames that were not judged for a whole window, nor while there are findings:
    a fault must not become normal.

    Parameters
    ----------
    input_names: order of a frame's inputs
    settings: window, thresholds
    step_s: of the grid
    is_temperature: whether an input is a temperature, by the unit of its readings; called when learning
    sink: receives every judgement, and an event when a finding begins and when all have ended
    clock: stands still while it computes
    before: what an earlier run saw
    is_load: whether an input is a load that heats, likewise
    """

    def __init__(
        self,
        input_names: Sequence[str],
        settings: SensorCheckSettings,
        step_s: float,
        is_temperature: Callable[[str], bool],
        sink: Sink,
        clock: ServiceClock,
        before: SeenBefore | None = None,
        learn: Learn = _learn_apart,
        is_load: Callable[[str], bool] = lambda _: False,
    ) -> None:
        self._names, self._settings, self._is_temperature = tuple(input_names), settings, is_temperature
        self._sink, self._clock, self._learn, self._is_load = sink, clock, learn, is_load
        self._step_s = step_s
        self._judge_every = min(steps_in(_JUDGE_EVERY_S, step_s), settings.window_steps)
        self._learn_every, self._learn_first = steps_in(_LEARN_EVERY_S, step_s), steps_in(_LEARN_FIRST_S, step_s)
        self._rows = LastRows(len(self._names), settings.learn_steps + settings.window_steps)
        self._first_k: int | None = None
        self._last_k: int | None = None
        self._model: SensorModel | None = None
        self._learnt_k: int | None = None
        self._problems = Problems(clock, self._judge_every * step_s, self._noticed, log)
        self._judged = self._quiet = 0
        """Number of judgements, and of those without a finding since the last one with a finding."""
        self._findings: list[_KnownFinding] = []
        self._suspect_since_k = None if before is None else before.suspect_since_k
        self._due = asyncio.Event()
        if before is not None:
            seen = before.frames
            for k, inputs, valid in zip(seen.k.tolist(), seen.inputs, seen.valid, strict=True):
                self._append(k, inputs, valid)
            if len(seen.k) >= settings.learn_steps + settings.window_steps:  # no more are loaded of a longer record
                self._first_k = int(seen.k[0]) - self._learn_first

    def follow(self, frame: Frame, _: Decision | None = None) -> None:
        """Take a frame; returns at once."""
        self._append(frame.k, frame.inputs, frame.valid)
        if self._settings.enabled and frame.k % self._judge_every == 0:
            self._due.set()

    async def run(self) -> None:
        """Check whenever it is due, until cancelled."""
        while True:
            await self._due.wait()
            self._due.clear()
            with self._clock.hold():
                await self.look()

    async def look(self) -> None:
        """Judge the last window; then learn, if a day has passed and nothing is suspect.

        Advice must not endanger the gateway: an error in one part is reported, and the part is tried again when due.
        """
        await self._attempt(NoticeCode.SENSORS_NOT_JUDGED, NoticeCode.SENSORS_JUDGED, self._judge)
        await self._attempt(NoticeCode.SENSORS_NOT_LEARNT, NoticeCode.SENSORS_LEARNT, self._learn_when_due)

    async def _attempt(self, failing: NoticeCode, works: NoticeCode, part: Callable[[], Awaitable[bool]]) -> None:
        try:
            if await part():
                self._problems.clear(failing, works)
        except WorkError as error:
            self._problems.report(failing, Text(failing, why=failure(error)), str(error))
        except Exception as error:  # noqa: BLE001 - reported with its traceback
            text = Text(NoticeCode.UNEXPECTED_ERROR, kind=type(error).__name__, error=str(error))
            self._problems.report(failing, Text(failing, why=text), text, bug=error)

    def _noticed(self, notice: Notice) -> None:
        self._report(problem_event(notice), self._last_k)

    def _report(self, event: Event, k: int | None) -> None:
        self._sink(EventReported(event, k))

    def _append(self, k: int, inputs: FloatArray, valid: BoolArray) -> None:
        if self._last_k is None:
            self._first_k = k
        else:
            self._rows.append_gap(k - self._last_k - 1)
        self._rows.append(inputs, valid)
        self._last_k = k

    async def _judge(self) -> bool:
        """Whether the window was judged; the window of an idle machine is not."""
        k, model = self._last_k, self._model
        if model is None or k is None:
            return False
        inputs, valid = self._rows.part(slice(-rows_needed(model, self._settings), None))
        given = model, self._names, inputs, valid, self._settings
        if len(model.names) <= _MOST_IN_A_THREAD:
            judgement = await asyncio.to_thread(judge, *given)
        else:
            judgement = await in_process(judge, *given)
        self._sink(SensorsJudged(judgement, k, tuple(self._since(finding, k) for finding in judgement.findings)))
        if not judgement.smallest_offset_K:
            return False
        self._compare(judgement.findings, k)
        return True

    def _since(self, finding: Finding, k: int) -> int:
        known = self._known(finding)
        return k if known is None else known.first_k

    def _known(self, finding: Finding) -> _KnownFinding | None:
        return next((known for known in self._findings if known.is_about(finding)), None)

    def _compare(self, findings: Sequence[Finding], k: int) -> None:
        """Counts judgements, not time: a weekend at rest, which is not judged, ends no finding."""
        self._judged += 1
        window = math.ceil(self._settings.window_steps / self._judge_every)
        for finding in findings:
            known = self._known(finding)
            if known is None:
                self._findings.append(known := _KnownFinding(finding, self._judged, self._judged, k))
            known.finding, known.last = finding, self._judged
            # While the window contains the beginning or end of an exchange, the exchange looks like an offset.
            wait = window if finding.kind == "offset" else window // 2
            if not known.told and self._judged - known.first >= wait:
                known.told = True
                self._tell(finding, k)
        self._findings = [s for s in self._findings if self._judged - s.last < (window if s.told else 1)]
        self._quiet = 0 if findings else self._quiet + 1
        if self._suspect_since_k is not None and self._quiet >= window and not self._findings:
            self._suspect_since_k = None
            log.warning("%s", Text(NoticeCode.SENSORS_AGREE))
            self._report(event_of(EventKind.SENSORS_AGREE, Text(NoticeCode.SENSORS_AGREE)), k)

    def _tell(self, finding: Finding, k: int) -> None:
        self._suspect_since_k = k if self._suspect_since_k is None else self._suspect_since_k
        text = finding_text(finding.kind, finding.inputs, finding.offset_K, finding.alternatives)
        log.warning("sensors: %s", text)
        value = None if finding.kind == "swap" else finding.offset_K
        self._report(event_of(EventKind.SENSOR_SUSPECT, text, value), k)

    async def _learn_when_due(self) -> bool:
        """Whether it was tried."""
        k, first_k = self._last_k, self._first_k
        if k is None or first_k is None or (self._learnt_k is not None and k - self._learnt_k < self._learn_every):
            return False
        if self._findings or (self._model is not None and self._suspect_since_k is not None):
            return False
        window = self._settings.window_steps
        left_out = 0
        if self._suspect_since_k is not None:  # from an earlier run
            left_out = k - self._suspect_since_k + 2 * window
        elif self._model is not None:
            left_out = window
        end = len(self._rows) - left_out
        # Fewer rows are kept than a day has, where `learn_steps` of a short grid step are less than a day.
        if k + 1 - first_k - left_out < self._learn_first or end < min(self._learn_first, self._settings.learn_steps):
            return False
        columns = [i for i, name in enumerate(self._names) if self._is_temperature(name)]
        if len(columns) < _LEAST_TEMPERATURES:
            return False
        inputs, valid = self._rows.part(slice(max(0, end - self._settings.learn_steps), end))
        loads = [i for i, name in enumerate(self._names) if i not in columns and self._is_load(name)]
        both = columns + loads
        names, told = [self._names[i] for i in both], [self._names[i] for i in loads]
        found = await self._learn(names, inputs[:, both], valid[:, both], self._settings, told, self._step_s)
        if found is not None:
            self._model, self._learnt_k = found, k
        return True
