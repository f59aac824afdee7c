"""`talc-gateway replay`: repeats the decisions of a database, or runs the controller on a user's recording."""

import hashlib
import json
import shlex
from collections import Counter
from dataclasses import asdict, dataclass, replace
from datetime import UTC
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import Progress

from gateway.config.prior import PriorError, PriorFile, described, prior_for
from gateway.config.problems import ConfigError, Problem
from gateway.config.talc_only import TalcOnly, load_talc_only
from gateway.control.replay.stored import replay
from gateway.model.text import Language
from gateway.reporting.data import ReportData
from gateway.reporting.recordings.columns import Columns
from gateway.reporting.recordings.grid import Recording, read_recording
from gateway.reporting.recordings.layout import ranges_text
from gateway.reporting.recordings.table import write_table
from gateway.runtime.bounded_memory import memory_for
from gateway.runtime.terminal import terminal
from gateway.storage.history import History
from talc.kinds import EventCode
from talc.learner.plausible import strange_cells
from talc.names import ERROR_UNITS, MICROMETRE, THERMAL_ERRORS, TINY_UM

_DAY_H = 24.0
_LEAST_CALIBRATION = 12
"""Measurements."""


def show(database: Path, language: str = "en") -> bool:
    """Replay with a progress bar and print the result; True if everything was identical."""
    console, said = terminal(), Language(language)
    with (
        History(database) as history,
        Progress(console=console, transient=True, disable=not console.is_terminal) as bar,
    ):
        task = bar.add_task(said("replay.progress"), total=None)
        result = replay(history, lambda steps: bar.update(task, completed=steps))
    counts = {"steps": result.steps, "trainings": result.trainings, "differences": result.differences}
    console.print(said("replay.compared", **counts))
    if result.first is not None:
        console.print(said("replay.first", k=result.first.k, what=result.first.what), style="red")
    console.print(said("replay.identical" if result.identical else "replay.different"))
    return result.identical


@dataclass(frozen=True, slots=True)
class Request:
    """A recording, and what was requested of it."""

    file: Path
    columns: Columns
    page: Path
    config: Path | None
    every_measurement: bool
    out: Path | None = None
    """Table of the steps to write; the table of the models is written beside it."""
    calibration_min: float | None = None
    """Time between the measurements of the calibration of trained models."""
    language: str = "en"
    """Of the page, and of what is printed."""
    zero_each_run: bool = False
    """Errors count from the first value of each run."""

    @property
    def models_out(self) -> Path | None:
        """Table of the models to write."""
        return None if self.out is None else self.out.with_name(f"{self.out.stem}-models{self.out.suffix}")

    def command(self) -> str:
        """The command that makes the page again."""
        words = ["talc-gateway", "replay", str(self.file)]
        words += [] if self.page == self.file.with_suffix(".html") else ["-o", str(self.page)]
        words += [] if self.config is None else ["--config", str(self.config)]
        words += [] if self.columns.time == Columns().time else ["--time", self.columns.time]
        words += [
            word for error, name in (self.columns.errors or {}).items() for word in ("--error", f"{error}={name}")
        ]
        words += [word for name in self.columns.ignored for word in ("--ignore", name)]
        words += [word for name in self.columns.inputs for word in ("--input", name)]
        words += [word for error, unit in self.columns.units.items() for word in ("--unit", f"{error}={unit}")]
        words += ["--time-of-day", self.columns.time_of_day] if self.columns.time_of_day else []
        words += ["--runs", self.columns.runs] if self.columns.runs else []
        words += ["--zero-each-run"] if self.zero_each_run else []
        words += ["--time-unit", self.columns.clock.unit] if self.columns.clock.unit else []
        words += ["--time-format", self.columns.clock.form] if self.columns.clock.form else []
        words += ["--time-zone", self.columns.clock.zone.key] if self.columns.clock.zone else []
        skipped = ranges_text(self.columns.layout.skip)
        words += ["--skip", skipped] if skipped else []
        words += [f"--missing={cell}" for cell in self.columns.layout.missing]
        words += [] if self.calibration_min is None else ["--calibration-interval", f"{self.calibration_min:g}"]
        words += ["--every-measurement"] if self.every_measurement else []
        return shlex.join(words)


def run_recording(request: Request) -> None:
    """Check the recording, run the controller over it, print the table and write the page."""
    from gateway.control.replay.recorded import column_named_twice, columns_of, learnt_columns, rehearse_recording
    from gateway.reporting.figures import summary, table
    from gateway.reporting.page import build

    sections = TalcOnly() if request.config is None else load_talc_only(request.config)
    with memory_for(request.file):
        recording = read_recording(request.file, request.columns, sections.grid.step_s)
    recording = _zeroed(recording, sections, request.file) if request.zero_each_run else recording
    if request.calibration_min is not None:
        sections = _calibrated(sections, recording, request.calibration_min, request.file)
    if request.out is not None:
        twice = column_named_twice(tuple(recording.error_columns), recording.input_names)
        if twice is not None:
            what = f"two columns would be called {twice!r}; --error NAME=COLUMN gives an error another name"
            raise ConfigError(request.out, [Problem("", what)])
    console, said = terminal(), Language(request.language)
    console.print(_roles(recording, request.columns, said), soft_wrap=True, markup=False, highlight=False)
    prior = _prior(sections, recording, request.config)
    if prior is not None:
        console.print(said.of(described(prior, recording.input_names)), soft_wrap=True)
    takes, longer = _calibration(recording, sections, said)
    if longer:
        console.print(said("replay.calibration_long", takes=takes, why=longer), soft_wrap=True)
    if request.calibration_min is not None:
        min_apart = sections.talc.control.calibration_interval_steps * recording.step_s / 60.0
        if abs(min_apart - request.calibration_min) > 0.01 * request.calibration_min:
            values = {"min": min_apart, "wanted": request.calibration_min, "step_s": recording.step_s}
            console.print(said("replay.calibration_every", **values), soft_wrap=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(said("replay.progress"), total=len(recording.k))
        data = rehearse_recording(
            recording,
            sections.talc,
            prior=None if prior is None else prior.prior,
            every_measurement=request.every_measurement,
            explained=request.out is not None,
            progress=lambda steps: bar.update(task, completed=steps),
        )
    _tell_no_values(console, recording, data, said)
    found = summary(data)
    if found.rows:
        console.print(table(found, said))
    else:
        basis, otherwise = said(f"report_basis.{found.basis}"), said(f"replay.otherwise_{sections.talc.method}")
        values = {"measured": data.cycles, "steps": len(data.k), "step_s": data.step_s}
        no_figures = said("replay.no_figures", basis=basis, takes=takes, otherwise=otherwise, **values)
        console.print(no_figures, soft_wrap=True)
    told = replace(
        data,
        language=request.language,
        made=_made(request, recording, sections, takes, prior, said),
        zone=request.columns.clock.zone or UTC,
    )
    request.page.write_text(build(told), encoding="utf-8")
    console.print(said("replay.report", page=str(request.page)), soft_wrap=True)
    if request.out is not None and request.models_out is not None:
        write_table(request.out, columns_of(data))
        write_table(request.models_out, learnt_columns(data))
        tables = said("replay.tables", steps=str(request.out), models=str(request.models_out))
        console.print(tables, soft_wrap=True)


def _roles(recording: Recording, columns: Columns, said: Language) -> str:
    """Which column was taken as what: a wrong role makes every figure meaningless."""
    errors = [
        (name if name == column else f"{name} = {column}")
        + (f" in {columns.units[name]}" if name in columns.units else "")
        for name, column in recording.error_columns.items()
    ]
    inputs, left = recording.input_names, [name or said("replay.first_column") for name in recording.ignored]
    lines = [said("replay.errors", names=errors), said("replay.inputs", n=len(inputs), names=inputs)]
    if left:
        lines.append(said("replay.left_out", names=left))
    lines += [*map(said.of, recording.notes), *_tiny(recording, said), *_constant(recording, said)]
    if recording.origin_s is not None:
        begin = said("replay.first_row_at" if recording.origin_s else "replay.first_row", origin_s=recording.origin_s)
        kind = said("replay.seconds" if recording.time_unit == "s" else "replay.numbers", unit=recording.time_unit)
        lines.append(said("replay.times", kind=kind, begin=begin))
    return "\n".join(lines)


def _constant(recording: Recording, said: Language) -> list[str]:
    """Remarks on inputs that can explain nothing."""
    known = np.isfinite(recording.inputs)
    low = np.min(recording.inputs, axis=0, initial=np.inf, where=known)
    high = np.max(recording.inputs, axis=0, initial=-np.inf, where=known)
    names = [name for name, a, b in zip(recording.input_names, low, high, strict=True) if a >= b]
    return [said("replay.unchanged", names=names)] if names else []


def _tiny(recording: Recording, said: Language) -> list[str]:
    """Remarks on errors that are hardly in µm: they would be left alone in silence."""
    lines = []
    for name, place, values in zip(recording.labels, THERMAL_ERRORS, recording.errors.T, strict=True):
        if name in recording.error_columns and ERROR_UNITS[place] == MICROMETRE:
            largest = float(np.max(np.abs(values), initial=0.0, where=np.isfinite(values)))
            if 0.0 < largest <= TINY_UM:
                unit = shlex.quote(f"{name}=mm")
                lines.append(said("replay.tiny", name=name, um=largest, unit=unit))
    return lines


def _tell_no_values(console: Console, recording: Recording, data: ReportData, said: Language) -> None:
    """What is no value: the cells of which input, how many and why; and the measurements that were not learnt from."""
    lines = []
    for cells in strange_cells(recording.input_names, recording.inputs, recording.k, recording.step_s):
        why = (
            said("replay.exchanged", name=cells.other)
            if cells.other != cells.input
            else said.word("input_fault", cells.fault)
        )
        hours = (int(recording.k[cells.first]) - int(recording.k[0])) * recording.step_s / 3600.0
        lines.append(said("replay.no_value", name=cells.input, n=cells.count, hours=hours, why=why))
    told = [event for _, event in data.events if event.code in (EventCode.NO_MEASUREMENT, EventCode.TAKEN_BACK)]
    faults = Counter(
        (str(e.error), str(e.values["measurement_fault"])) for e in told if e.code == EventCode.NO_MEASUREMENT
    )
    for (error, fault), count in faults.items():
        why = said.word("measurement_fault", fault)
        lines.append(said("replay.not_learnt", name=error, n=count, why=why))
    forgotten = Counter[str]()
    for event in told:
        forgotten[str(event.error)] += int(event.values.get("n", 0))
    lines += [said("replay.forgotten", name=error, n=n) for error, n in forgotten.items() if n]
    for line in lines:
        console.print(line, soft_wrap=True, markup=False, highlight=False)


def _zeroed(recording: Recording, sections: TalcOnly, file: Path) -> Recording:
    """The recording with errors that count from the first value of each run. Raises ConfigError."""
    if sections.talc.method != "learner":
        what = "trained models count from one reference; use the learner, or leave it out"
        raise ConfigError(file, [Problem("--zero-each-run", what)])
    errors, run = recording.errors.copy(), np.searchsorted(np.array(recording.restarts), recording.k, side="right")
    for column in errors.T:
        for rows in (run == number for number in np.unique(run)):
            known = column[rows & np.isfinite(column)]
            column[rows] -= known[0] if known.size else 0.0
    return replace(recording, errors=errors, zero_each_run=True)


def _calibrated(sections: TalcOnly, recording: Recording, minutes: float, file: Path) -> TalcOnly:
    """The settings with the calibration's measurements this far apart, and at least as many as it needs. Raises
    ConfigError."""
    if sections.talc.method == "learner":
        what = 'the learner has no calibration; it is for `method = "models"`, with --config'
        raise ConfigError(file, [Problem("--calibration-interval", what)])
    every, control = max(round(minutes * 60.0 / recording.step_s), 1), sections.talc.control
    steps = max(control.calibration_steps, _LEAST_CALIBRATION * every)
    try:
        control = replace(control, calibration_interval_steps=every, calibration_steps=steps)
        return sections.model_copy(update={"talc": replace(sections.talc, control=control)})
    except ValueError as error:
        raise ConfigError(file, [Problem("--calibration-interval", str(error))]) from None


def _prior(sections: TalcOnly, recording: Recording, config: Path | None) -> PriorFile | None:
    """The prior that `[talc] prior` of the file names. Raises ConfigError."""
    try:
        return prior_for(sections.talc, recording.input_names)
    except PriorError as error:
        raise ConfigError(config or Path(), [Problem("[talc] prior", str(error))]) from None


def _calibration(recording: Recording, sections: TalcOnly, said: Language) -> tuple[str, str]:
    """How long calibration takes; and the reason, when that is longer than expected."""
    if sections.talc.method == "learner":
        return said("replay.no_time"), ""
    control, step_s = sections.talc.control, recording.step_s
    hours, lasts = control.calibration_steps * step_s / 3600, int(np.ptp(recording.k) + 1) * step_s / 3600
    every = control.calibration_interval_steps
    measured = said("replay.each_step" if every == 1 else "replay.each_steps", n=every)
    takes = said("replay.takes", n=control.calibration_steps, step_s=step_s, hours=hours, measured=measured)
    if hours > lasts:
        return takes, said("replay.longer", hours=lasts)
    if hours > _DAY_H and step_s > sections.grid.step_s:
        return takes, said("replay.row_is_step", step_s=step_s, day=_DAY_H * 3600 / step_s)
    return takes, ""


def _made(
    request: Request,
    recording: Recording,
    sections: TalcOnly,
    calibration: str,
    prior: PriorFile | None,
    said: Language,
) -> tuple[tuple[str, str], ...]:
    """What is needed to make the page again."""
    file, config = request.file, request.config
    errors = (name if name == column else f"{name} = {column}" for name, column in recording.error_columns.items())
    used = said("replay_made.each_one" if request.every_measurement else "replay_made.requested")
    left = [name or said("replay.first_column") for name in recording.ignored]
    fixed = said("replay_made.defaults") if config is None else f"{config.name}, SHA-256 {_sha256(config)}"
    talc = asdict(sections.talc)
    own = {name: value for name, value in talc.items() if not isinstance(value, dict)}
    tables = [("", own), *((f".{name}", value) for name, value in talc.items() if isinstance(value, dict))]
    return (
        (said("replay_made.file"), f"{file.name}, {file.stat().st_size} bytes, SHA-256 {recording.sha256}"),
        (said("replay_made.command"), request.command()),
        (said("replay_made.errors"), ", ".join(errors)),
        (said("replay_made.left_out"), ", ".join(left) or said("replay_made.none")),
        *(((said("replay_made.reading"), "; ".join(map(said.of, recording.notes))),) if recording.notes else ()),
        (said("replay_made.used"), used),
        (said("replay_made.calibration"), calibration),
        (said("replay_made.settings"), fixed),
        *(() if prior is None else ((said("replay_made.prior"), f"SHA-256 {prior.content_hash}"),)),
        ("[grid]", f"step_s = {sections.grid.step_s:g}"),
        *((f"[talc{part}]", ", ".join(f"{k} = {json.dumps(v)}" for k, v in keys.items())) for part, keys in tables),
    )


def _sha256(file: Path) -> str:
    with file.open("rb") as content:
        return hashlib.file_digest(content, "sha256").hexdigest()
