"""The controller of an earlier run: from its last snapshot, or from the record alone, and the steps after it."""

import hashlib
import json
import logging
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field, replace
from functools import cache, partial
from pathlib import Path

import numpy as np

import talc
from gateway.config.model import GatewayConfig
from gateway.model.codes import NoticeCode
from gateway.model.text import Text, text_of
from gateway.runtime.versions import versions
from gateway.storage.history import History
from gateway.storage.learnt import Learnt, parse_learnt
from gateway.storage.snapshot import Snapshot, SnapshotError, decode_snapshot, marks_of
from gateway.storage.stored import StoredStep
from talc.control import Controller
from talc.frame import Decision, Frame, TrainingJob, Why
from talc.learner import CourseState
from talc.names import THERMAL_ERRORS
from talc.settings import ControlSettings, LearnerSettings, TalcSettings, TrainingSettings
from talc.transfer import transferred

log = logging.getLogger(__name__)


class Interrupted(Exception):
    """A rebuild was ended before its end."""


def controller_of(config: GatewayConfig) -> Controller:
    """A fresh controller of a configuration."""
    prior = None if config.prior is None else config.prior.prior
    return Controller(config.input_names, config.talc, config.grid.step_s, prior)


def continued(learnt: Learnt, config: GatewayConfig, *, of_record: bool = False) -> Controller:
    """A controller of the configuration that knows what was learnt. ValueError: it does not fit, and why.

    of_record: its grid indices are those of the frames that follow
    """
    if learnt.method != config.talc.method:
        raise ValueError(f"method = {learnt.method!r}: [talc] method is {config.talc.method!r} here")
    if learnt.step_s != config.grid.step_s:
        raise ValueError(f"step_s = {learnt.step_s:g}: [grid] step_s is {config.grid.step_s:g} here")
    if not set(learnt.state.input_names) & set(config.input_names):
        raise ValueError("inputs: none of them has the name of an input here; inputs are matched by name")
    state = transferred(learnt.state, controller_of(config).state())
    if of_record and (was := learnt.state.course) is not None and isinstance(state.strategy, CourseState):
        same = replace(state.strategy, last_k=was.last_k, last_measured=was.last_measured, wanted=was.wanted)
        unchanged = tuple(learnt.state.input_names) == tuple(config.input_names)
        state = replace(state, strategy=was if unchanged else same)
    prior = None if config.prior is None else config.prior.prior
    return Controller.restore(state, config.talc, config.grid.step_s, prior)


def used(settings: TalcSettings) -> tuple[LearnerSettings | ControlSettings | TrainingSettings, ...]:
    """The parts of the settings that the method uses."""
    return (settings.learner,) if settings.method == "learner" else (settings.control, settings.training)


@dataclass(slots=True)
class Rebuilt:
    """A controller after stored steps, and what it was then waiting for."""

    controller: Controller
    last_k: int | None = None
    measure: Why | None = None
    """The measurement that was wanted."""
    job: TrainingJob | None = None
    """A training that was wanted and has not ended."""
    missing: dict[str, int] = field(default_factory=dict)
    """Inputs of live models without a good value at the last step, and the grid index since when."""
    measured: list[int | None] = field(default_factory=lambda: [None] * len(THERMAL_ERRORS))
    """Grid index of each error's last measurement."""
    steps: int = 0
    """Taken since the last snapshot, or since the start of the record."""
    from_snapshot: bool = False

    @property
    def after_k(self) -> int:
        """Behind which grid index the record goes on."""
        return -1 if self.last_k is None else self.last_k

    def follow(self, frame: Frame, decision: Decision) -> None:
        """Take note of a step that the controller has taken."""
        self.last_k, self.measure, self.steps = decision.k, decision.measure, self.steps + 1
        self.missing = {name: self.missing.get(name, frame.k) for name in decision.substituted}
        if frame.measurement is not None:
            new = np.isfinite(frame.measurement.errors)
            self.measured = [frame.k if n else k for n, k in zip(new, self.measured, strict=True)]

    def snapshot_if_due(self, every_steps: int, marks: str) -> Snapshot | None:
        """All of it, if that many steps were taken since the last snapshot; None if fewer.

        None also while a training is in progress, which is not part of a snapshot.
        """
        if self.steps < every_steps or self.controller.learning:
            return None
        self.steps = 0
        return Snapshot(marks, self.controller.state(), self.measure, self.missing, tuple(self.measured))


def start_of(config: GatewayConfig, history: History) -> Rebuilt:
    """What the record begins with: what stands for its first steps, or was imported, as far as names match.

    Raises ValueError if that is damaged.
    """
    if (learnt := history.learnt()) is None:
        return Rebuilt(controller_of(config))
    text, last_k = learnt
    of_record = last_k >= 0
    found = parse_learnt(text)
    try:
        controller = continued(found, config, of_record=of_record)
    except ValueError as error:
        log.warning("%s", Text(NoticeCode.IMPORT_NOT_USED, why=text_of(error)))
        controller = controller_of(config)
    return Rebuilt(controller, last_k if of_record else None)


RebuildProgress = Callable[[Rebuilt], None]
"""Called after every step of a rebuild; ends it by raising Interrupted."""


def go_on(_: Rebuilt) -> None:
    """Let the rebuild go on."""


def rebuilt(
    steps: Iterable[StoredStep], config: GatewayConfig, found: Rebuilt, progress: RebuildProgress = go_on
) -> Rebuilt:
    """A controller of a configuration, after the stored frames and models. A learner takes only the frames.

    found: continued from
    """
    for step in steps:
        decision = found.controller.step(step.frame)
        found.follow(step.frame, decision)
        found.job = decision.training or found.job
        for stored in () if config.talc.method == "learner" else step.adopted:
            found.controller.adopt(stored)
            found.job = None
        progress(found)
    return found


def rebuilt_from(history: History, config: GatewayConfig, progress: RebuildProgress = go_on) -> Rebuilt:
    """The controller after the whole record: from the latest snapshot of the same settings and program, if any."""
    start = _restored(history, config) or start_of(config, history)
    return rebuilt(history.steps(start.after_k, config.input_names), config, start, progress)


def _restored(history: History, config: GatewayConfig) -> Rebuilt | None:
    wanted = marks(config)
    for data in history.snapshots():
        try:
            if marks_of(data) != wanted:
                continue
            found = decode_snapshot(data, partial(history.frames, config.input_names))
            prior = None if config.prior is None else config.prior.prior
            controller = Controller.restore(found.state, config.talc, config.grid.step_s, prior)
        except (SnapshotError, ValueError) as error:
            log.warning("%s", Text(NoticeCode.SNAPSHOT_NOT_USED, why=text_of(error)))
            continue
        return Rebuilt(
            controller,
            found.k,
            found.measure,
            missing=dict(found.missing),
            measured=list(found.measured),
            from_snapshot=True,
        )
    return None


def marks(config: GatewayConfig) -> str:
    """Fingerprint of all that decisions follow from, besides the frames: settings, prior, inputs, program, numerics."""
    prior = None if config.prior is None or config.talc.method != "learner" else config.prior.content_hash
    settings = [asdict(part) for part in used(config.talc)]
    told = [config.talc.method, settings, config.input_names, config.grid.step_s, prior]
    return hashlib.sha256(json.dumps([*told, _program()]).encode()).hexdigest()


@cache
def _program() -> str:
    """Fingerprint of the program of the decisions, its kernel included, and the versions of what it depends on."""
    found = hashlib.sha256(versions().encode())
    for folder in map(Path, talc.__path__):
        for path in sorted(path for path in folder.rglob("*") if path.suffix in (".py", ".so")):
            found.update(path.relative_to(folder).as_posix().encode() + path.read_bytes())
    return found.hexdigest()
