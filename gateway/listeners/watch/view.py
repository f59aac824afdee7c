"""The view of a running gateway in `demo` and `watch`: decoded telemetry, drawn with rich."""

import threading
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from types import TracebackType
from typing import Self, assert_never

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.panel import Panel
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from drivers.base import Clock, Quality
from gateway.model.events import GatewayEvent, Sink
from gateway.model.text import Language, restored
from gateway.model.wording import finding_text
from gateway.runtime.terminal import duration_text, terminal
from gateway.telemetry.compose import Composer
from gateway.telemetry.fields import text_from, texts_from
from gateway.telemetry.messages import (
    CompensationMessage,
    DecisionMessage,
    EventMessage,
    ForecastMessage,
    FrameMessage,
    MeasurementMessage,
    ModelMessage,
    ProbingMessage,
    Published,
    ReadingMessage,
    ReasonsMessage,
    SensorFinding,
    SensorsMessage,
    StatusMessage,
)
from talc.frame import EventKind
from talc.names import ERROR_UNITS, THERMAL_ERRORS

_EVENTS_SHOWN = 5
_READINGS_BESIDE = 3
_REFRESH_PER_S = 4
_SUMMARY_EVERY_S = 6 * 3600.0
_PHASE_STYLE = {"calibration": "yellow", "compensation": "green", "no_good": "red"}
_NOTABLE = frozenset(
    {
        EventKind.PHASE_CHANGED,
        EventKind.MODEL_REJECTED,
        EventKind.PROBLEM,
        EventKind.PROBLEM_ENDED,
        EventKind.MEASUREMENT_REJECTED,
        EventKind.OPERATOR,
        EventKind.SENSOR_SUSPECT,
        EventKind.SENSORS_AGREE,
        EventKind.COMMAND,
    }
)


@dataclass(slots=True)
class ViewState:
    """The latest of everything. Times are UTC as published."""

    machine: str
    progress_until_s: float | None = None
    """Length of the run, if it ends by itself."""
    time: datetime | None = None
    began: datetime | None = None
    simulated: bool = False
    alive: bool = True
    phase: str = ""
    k: int = 0
    predicted: dict[str, float | None] = field(default_factory=dict)
    corrected: dict[str, float | None] = field(default_factory=dict)
    sigma: dict[str, float | None] = field(default_factory=dict)
    limits: dict[str, float | None] = field(default_factory=dict)
    measured: dict[str, float | None] = field(default_factory=dict)
    measured_at: datetime | None = None
    inputs: dict[str, tuple[str, ...] | None] = field(default_factory=dict)
    """By error; None: it is not corrected."""
    channels: dict[str, str] = field(default_factory=dict)
    """Channel to quality."""
    values: dict[str, str] = field(default_factory=dict)
    """Channel to its last value with its unit, or to its quality when that is not good."""
    offsets_um: tuple[float, float, float] = (0.0, 0.0, 0.0)
    mode: str = ""
    source: str = ""
    probing: str = ""
    """Why a wanted measurement is waiting."""
    unarmed: tuple[str, ...] = ()
    """What is off in the configuration, and what follows."""
    sensors: list[str] = field(default_factory=list)
    """Sensors that disagree with the others."""
    measurements: int = 0
    rejected: int = 0
    state_updates: int = 0
    model_updates: int = 0
    events: deque[tuple[datetime, str, str]] = field(default_factory=lambda: deque(maxlen=200))
    events_seen: int = 0
    _last_models_k: int | None = None

    def apply(self, message: Published) -> None:  # noqa: C901 - one arm for each kind of message
        """Update the state with one message."""
        now = datetime.fromisoformat(message.time)
        self.time = now if self.time is None else max(self.time, now)
        self.began = self.began or now
        self.simulated = message.clock == "simulated"
        match message:
            case ReadingMessage():
                self.channels[message.channel] = message.quality
                self.values[message.channel] = _value(message)
            case DecisionMessage():
                self.phase, self.k = message.phase, message.k
                self.predicted, self.corrected = message.predicted, message.corrected
                self.sigma, self.limits = message.sigma, message.limits
            case MeasurementMessage():
                self._measured(message)
            case ModelMessage():
                self._adopted(message)
            case CompensationMessage():
                self.offsets_um, self.mode, self.source = message.offsets_um, message.mode, message.source
            case ReasonsMessage():
                self._reasoned(message)
            case SensorsMessage():
                self.sensors = [_finding(finding) for finding in message.findings]
            case ProbingMessage():
                self.probing = text_from(message.reason, message.reason_coded)
            case EventMessage():
                self.state_updates += message.kind == EventKind.STATE_UPDATE
                self.events.append((now, message.kind, restored(message.text, message.code, message.values)))
                self.events_seen += 1
            case StatusMessage():
                self.unarmed = texts_from(message.unarmed, message.unarmed_coded)
            case FrameMessage() | ForecastMessage():
                pass
            case _:
                assert_never(message)

    def warn(self, text: str) -> None:
        """What this program has found itself, among the events."""
        self.events.append((self.time or datetime.now(UTC), EventKind.PROBLEM, text))
        self.events_seen += 1

    def _measured(self, message: MeasurementMessage) -> None:
        self.measurements += 1
        if message.errors is None:
            self.rejected += 1
        else:
            self.measured, self.measured_at = message.errors, datetime.fromisoformat(message.ended)

    def _adopted(self, message: ModelMessage) -> None:
        self.inputs[message.error] = message.inputs
        if message.after_k != self._last_models_k:
            self._last_models_k = message.after_k
            self.model_updates += 1

    def _reasoned(self, message: ReasonsMessage) -> None:
        for name, reason in message.errors.items():
            moved = ((i, um) for i, um in reason.inputs.items() if um is not None)
            self.inputs[name] = tuple(f"{i} {um:+.1f}" for i, um in moved) if reason.trusted else None

    @property
    def elapsed_s(self) -> float:
        """Time since the first message."""
        return 0.0 if self.time is None or self.began is None else (self.time - self.began).total_seconds()


def render(state: ViewState, said: Language = Language()) -> RenderableType:  # noqa: B008 - frozen
    """The whole screen; 80 columns are enough."""
    return Group(
        _header(state, said), _readings(state, said), _errors(state, said), _footer(state, said), _events(state, said)
    )


def _header(s: ViewState, said: Language) -> RenderableType:
    text = Text()
    text.append(f"{s.machine}  ", style="bold")
    text.append(f"{s.time:%Y-%m-%d %H:%M} UTC" if s.time else said("watch.waiting"))
    text.append(f" {said('watch.simulated')}  " if s.simulated else "  ", style="dim")
    text.append(_phase(s, said), style=f"bold {_PHASE_STYLE.get(s.phase, 'white')}")
    if not s.alive:
        text.append(f"  {said('watch.offline')}", style="bold red")
    parts: list[RenderableType] = [text]
    if s.progress_until_s:
        grid = Table.grid(padding=(0, 1), expand=True)
        grid.add_column(ratio=1)
        grid.add_column(justify="right")
        bar = ProgressBar(total=s.progress_until_s, completed=min(s.elapsed_s, s.progress_until_s))
        grid.add_row(bar, said("watch.progress", done_h=s.elapsed_s / 3600, all_h=s.progress_until_s / 3600))
        parts.append(grid)
    bad = sorted(c for c, q in s.channels.items() if q != Quality.GOOD)
    good = said("status.channels", good=len(s.channels) - len(bad), all=len(s.channels))
    health = Text(good, style="red" if bad else "green")
    if bad:
        named = ", ".join(f"{c} {said.word('quality', s.channels[c])}" for c in bad[:4])
        health.append(f"; {named}{' ...' if len(bad) > 4 else ''}")
    parts.append(health)
    parts += [Text(said.of(text), style="yellow") for text in s.unarmed]
    parts += [Text(said("watch.sensors", text=text), style="red") for text in s.sensors]
    return Panel(Group(*parts), padding=(0, 1))


def _phase(s: ViewState, said: Language) -> str:
    return said.word("phase", s.phase) if s.phase else said("watch.starting")


def _finding(finding: SensorFinding) -> str:
    if finding.offset_K is None:
        return finding.text
    return finding_text(finding.kind, finding.inputs, finding.offset_K, finding.alternatives)


def _value(message: ReadingMessage) -> str:
    if message.value is None or message.quality != Quality.GOOD:
        return message.quality
    return f"{message.value:z.1f} {message.unit}"


def _readings(s: ViewState, said: Language) -> RenderableType:
    """Every channel in as many rows as it takes, side by side."""
    grid = Table.grid(padding=(0, 1), expand=True)
    for _ in range(_READINGS_BESIDE):
        grid.add_column(ratio=1, no_wrap=True, overflow="ellipsis", style="dim")
        grid.add_column(justify="right", no_wrap=True)
    cells = [
        cell
        for channel, value in sorted(s.values.items())
        for cell in (Text(channel), _cell(s.channels[channel], value, said))
    ]
    width = 2 * _READINGS_BESIDE
    for start in range(0, len(cells), width):
        grid.add_row(*cells[start : start + width])
    return grid


def _cell(quality: str, value: str, said: Language) -> Text:
    return Text(value) if quality == Quality.GOOD else Text(said.word("quality", quality), style="red")


def _errors(s: ViewState, said: Language) -> RenderableType:
    table = Table(expand=True, pad_edge=False, header_style="bold")
    for name in ("error", "unit", "predicted", "sigma", "measured", "limit", "inputs"):
        left = name in ("error", "unit", "inputs")
        heading = said(f"watch.{name}")
        table.add_column(
            heading, justify="left" if left else "right", no_wrap=True, ratio=1 if name == "inputs" else None
        )
    for name in THERMAL_ERRORS:
        sigma = s.sigma.get(name)
        table.add_row(
            name,
            ERROR_UNITS[name],
            _tenths(s.predicted.get(name)),
            _tenths(None if sigma is None else 2 * sigma),
            _tenths(s.measured.get(name)),
            _tenths(s.limits.get(name)),
            Text(_moved(s.inputs.get(name, ()), said), overflow="ellipsis", style="dim"),
        )
    return table


def _moved(inputs: Sequence[str] | None, said: Language) -> str:
    return said("watch.not_corrected") if inputs is None else ", ".join(inputs)


def _footer(s: ViewState, said: Language) -> RenderableType:
    x, y, z = s.offsets_um
    place = said("watch.offsets", x=x, y=y, z=z)
    mode = said("watch.compensation", mode=s.mode or "-", source=s.source or said("watch.nothing_yet"), offsets=place)
    age = ""
    if s.measured_at is not None and s.time is not None:
        age = said("watch.age", age=duration_text((s.time - s.measured_at).total_seconds()))
    counts = said(
        "watch.counts",
        n=s.measurements, rejected=s.rejected, age=age, states=s.state_updates, models=s.model_updates,
    )  # fmt: skip
    return Text("\n".join([mode, counts, *([said("watch.probing", text=s.probing)] if s.probing else [])]))


def _events(s: ViewState, said: Language) -> RenderableType:
    lines = [f"{at:%d. %H:%M}  {said.of(text)}" for at, _, text in list(s.events)[-_EVENTS_SHOWN:]]
    lines += [""] * (_EVENTS_SHOWN - len(lines))
    return Text("\n".join(lines), style="dim", no_wrap=True, overflow="ellipsis")


def _tenths(value: float | None) -> str:
    return "-" if value is None else f"{value:z.1f}"


def feeding(state: ViewState, input_names: Sequence[str], clock: Clock, *, simulated: bool) -> Sink:
    """A sink that feeds a state in this process with the same messages as telemetry."""
    composer = Composer("", input_names, clock, simulated=simulated)

    def take(event: GatewayEvent) -> None:
        for _, message in composer.messages(event):
            state.apply(message)

    return take


class LiveView:
    """Shows a ViewState while the context lasts: redrawn on a terminal, a line per notable event elsewhere.

    Parameters
    ----------
    plain: print lines even on a terminal
    summary_at_once: of the lines, the first is a summary; otherwise one comes after six hours
    console: where to print; None: standard output
    language: of the catalogue
    """

    def __init__(
        self,
        state: ViewState,
        *,
        plain: bool = False,
        summary_at_once: bool = False,
        console: Console | None = None,
        language: str = "en",
    ) -> None:
        self._state, self._console, self._said = state, console or terminal(), Language(language)
        self._live: Live | None = None
        if self._console.is_terminal and not plain:
            self._live = Live(
                get_renderable=lambda: render(state, self._said),
                console=self._console,
                refresh_per_second=_REFRESH_PER_S,
                screen=False,
            )
        self._seen, self._summarised = 0, -_SUMMARY_EVERY_S if summary_at_once else 0.0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._lines, name="view", daemon=True)

    def __enter__(self) -> Self:
        if self._live is not None:
            self._live.start(refresh=True)
        else:
            self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None:
            self._live.stop()
        else:
            self._stop.set()
            self._thread.join()

    def _lines(self) -> None:
        while not self._stop.wait(1.0 / _REFRESH_PER_S):
            self._print_news()
        self._print_news()

    def _print_news(self) -> None:
        s = self._state
        fresh = s.events_seen - self._seen
        self._seen += fresh
        for at, kind, text in list(s.events)[len(s.events) - min(fresh, len(s.events)) :]:
            if kind in _NOTABLE:
                self._print(f"{at:%Y-%m-%d %H:%M}  {self._said.of(text)}")
        if s.time is not None and s.elapsed_s - self._summarised >= _SUMMARY_EVERY_S:
            self._summarised = s.elapsed_s - s.elapsed_s % _SUMMARY_EVERY_S
            offsets = ", ".join(f"{v:+.1f}" for v in s.offsets_um)
            said, n, models = self._said, s.measurements, s.model_updates
            summary = said("watch.summary", phase=_phase(s, said), n=n, models=models, offsets=offsets)
            self._print(f"{s.time:%Y-%m-%d %H:%M}  {summary}")
            for text in s.unarmed:
                self._print(f"  {said.of(text)}")
            if s.values:
                values = ((c, _cell(s.channels[c], value, said).plain) for c, value in sorted(s.values.copy().items()))
                self._print("  " + ", ".join(f"{channel} {value}" for channel, value in values))

    def _print(self, line: str) -> None:
        self._console.print(line, highlight=False, soft_wrap=True)
