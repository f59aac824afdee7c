"""`talc-gateway replay`: repeats the decisions of a database, or runs the controller on a user's recording."""

import hashlib
import json
import shlex
from dataclasses import asdict, dataclass, replace
from datetime import UTC
from pathlib import Path

import numpy as np
from rich.progress import Progress

from gateway.config.prior import PriorError, PriorFile, described, prior_for
from gateway.config.problems import ConfigError, Problem
from gateway.config.talc_only import TalcOnly, load_talc_only
from gateway.control.replay.stored import replay
from gateway.model.text import Language
from gateway.reporting.recordings.columns import Columns
from gateway.reporting.recordings.grid import Recording, read_recording
from gateway.reporting.recordings.layout import ranges_text
from gateway.reporting.recordings.table import write_table
from gateway.runtime.terminal import terminal
from gateway.storage.history import History
from talc.names import ERROR_UNITS, MICROMETRE, THERMAL_ERRORS, TINY_UM

_DAY_H = 24.0
_LEAST_CALIBRATION = 12
"""Measurements."""


def show(database: Path) -> bool:
    """Replay with a progress bar and print the result; True if everything was identical."""
    console = terminal()
    with (
        History(database) as history,
        Progress(console=console, transient=True, disable=not console.is_terminal) as bar,
    ):
        task = bar.add_task("replaying", total=None)
        result = replay(history, lambda steps: bar.update(task, completed=steps))
    console.print(f"{result.steps} steps, {result.trainings} trainings, {result.differences} differences")
    if result.first is not None:
        console.print(f"first difference at step {result.first.k}: {result.first.what}", style="red")
    console.print("identical" if result.identical else "NOT identical")
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
    """Of the page."""

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
        words += ["--time-unit", self.columns.clock.unit] if self.columns.clock.unit else []
        words += ["--time-format", self.columns.clock.form] if self.columns.clock.form else []
        words += ["--time-zone", self.columns.clock.zone.key] if self.columns.clock.zone else []
        skipped = ranges_text(self.columns.layout.skip)
        words += ["--skip", skipped] if skipped else []
        words += [f"--missing={cell}" for cell in self.columns.layout.missing]
        words += [] if self.calibration_min is None else ["--calibration-interval", f"{self.calibration_min:g}"]
        words += ["--every-measurement"] if self.every_measurement else []
        return shlex.join(words)


_SAID_OTHERWISE = {
    "learner": "the learner corrects from the first measurement on",
    "models": "--calibration-interval is for errors measured less often, and --config with [talc.control] "
    "calibration_steps for a shorter or longer one",
}


def run_recording(request: Request) -> None:
    """Check the recording, run the controller over it, print the table and write the page."""
    from gateway.control.replay.recorded import column_named_twice, columns_of, learnt_columns, rehearse_recording
    from gateway.reporting.figures import summary, table
    from gateway.reporting.page import build

    sections = TalcOnly() if request.config is None else load_talc_only(request.config)
    recording = read_recording(request.file, request.columns, sections.grid.step_s)
    if request.calibration_min is not None:
        sections = _calibrated(sections, recording, request.calibration_min, request.file)
    if request.out is not None:
        twice = column_named_twice(tuple(recording.error_columns), recording.input_names)
        if twice is not None:
            what = f"two columns would be called {twice!r}; --error NAME=COLUMN gives an error another name"
            raise ConfigError(request.out, [Problem("", what)])
    console = terminal()
    console.print(_roles(recording, request.columns), soft_wrap=True, markup=False, highlight=False)
    prior = _prior(sections, recording, request.config)
    if prior is not None:
        console.print(described(prior, recording.input_names), soft_wrap=True)
    takes, longer = _calibration(recording, sections)
    if longer:
        console.print(f"Calibration takes {takes}, {longer}", soft_wrap=True)
    if request.calibration_min is not None:
        min_apart = sections.talc.control.calibration_interval_steps * recording.step_s / 60.0
        if abs(min_apart - request.calibration_min) > 0.01 * request.calibration_min:
            instead = f"{min_apart:g} min instead of {request.calibration_min:g}"
            steps = f"whole steps of {recording.step_s:g} s"
            console.print(f"Calibration is measured every {instead}: in {steps}", soft_wrap=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("replaying", total=len(recording.k))
        data = rehearse_recording(
            recording,
            sections.talc,
            prior=None if prior is None else prior.prior,
            every_measurement=request.every_measurement,
            explained=request.out is not None,
            progress=lambda steps: bar.update(task, completed=steps),
        )
    found = summary(data)
    if found.rows:
        console.print(table(found, Language(request.language)))
    else:
        basis = Language()(f"report_basis.{found.basis}")
        console.print(
            f"no figures: {basis}; {data.cycles} of {len(data.k)} steps of {data.step_s:g} s hold a measurement. "
            f"Calibration takes {takes}; {_SAID_OTHERWISE[sections.talc.method]}",
            soft_wrap=True,
        )
    told = replace(
        data,
        language=request.language,
        made=_made(request, recording, sections, takes, prior),
        zone=request.columns.clock.zone or UTC,
    )
    request.page.write_text(build(told), encoding="utf-8")
    console.print(f"report: {request.page}", soft_wrap=True)
    if request.out is not None and request.models_out is not None:
        write_table(request.out, columns_of(data))
        write_table(request.models_out, learnt_columns(data))
        console.print(f"tables: {request.out} (steps), {request.models_out} (models)", soft_wrap=True)


def _roles(recording: Recording, columns: Columns) -> str:
    """Which column was taken as what: a wrong role makes every figure meaningless."""
    errors = [
        (name if name == column else f"{name} = {column}")
        + (f" in {columns.units[name]}" if name in columns.units else "")
        for name, column in recording.error_columns.items()
    ]
    inputs, left = recording.input_names, [name or "the first" for name in recording.ignored]
    lines = [f"errors: {', '.join(errors)}", f"inputs ({len(inputs)}): {', '.join(inputs)}"]
    if left:
        lines.append(f"left out: {', '.join(left)}")
    lines += [*recording.notes, *_tiny(recording), *_constant(recording)]
    if recording.origin_s is not None:
        begin = f"the first row, {recording.origin_s:g} s" if recording.origin_s else "the first row"
        kind = "seconds" if recording.time_unit == "s" else f"numbers in {recording.time_unit}"
        lines.append(f"times: {kind} without a date; the report counts hours from {begin}")
    return "\n".join(lines)


def _constant(recording: Recording) -> list[str]:
    """Remarks on inputs that can explain nothing."""
    known = np.isfinite(recording.inputs)
    low = np.min(recording.inputs, axis=0, initial=np.inf, where=known)
    high = np.max(recording.inputs, axis=0, initial=-np.inf, where=known)
    names = [name for name, a, b in zip(recording.input_names, low, high, strict=True) if a >= b]
    return [f"inputs without any change, or without a value: {', '.join(names)}"] if names else []


def _tiny(recording: Recording) -> list[str]:
    """Remarks on errors that are hardly in µm: they would be left alone in silence."""
    lines = []
    for name, place, values in zip(recording.labels, THERMAL_ERRORS, recording.errors.T, strict=True):
        if name in recording.error_columns and ERROR_UNITS[place] == MICROMETRE:
            largest = float(np.max(np.abs(values), initial=0.0, where=np.isfinite(values)))
            if 0.0 < largest <= TINY_UM:
                unit = shlex.quote(f"{name}=mm")
                lines.append(
                    f"{name} is at most {largest:.2g} µm, too little to be learnt; if it is in mm: --unit {unit}"
                )
    return lines


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


def _calibration(recording: Recording, sections: TalcOnly) -> tuple[str, str]:
    """How long calibration takes; and the reason, when that is longer than expected."""
    if sections.talc.method == "learner":
        return "no time", ""
    control, step_s = sections.talc.control, recording.step_s
    hours, lasts = control.calibration_steps * step_s / 3600, int(np.ptp(recording.k) + 1) * step_s / 3600
    every = control.calibration_interval_steps
    measured = "measured at every step" if every == 1 else f"measured each {every} steps"
    takes = f"{control.calibration_steps} steps of {step_s:g} s, {hours:.1f} h, {measured}"
    if hours > lasts:
        return takes, f"longer than the recording, {lasts:.1f} h: there will be no figures"
    if hours > _DAY_H and step_s > sections.grid.step_s:
        return (
            takes,
            f"as rows {step_s:g} s apart are a step each: calibration_steps = {_DAY_H * 3600 / step_s:.0f} is a day",
        )
    return takes, ""


def _made(
    request: Request, recording: Recording, sections: TalcOnly, calibration: str, prior: PriorFile | None
) -> tuple[tuple[str, str], ...]:
    """What is needed to make the page again."""
    file, config = request.file, request.config
    errors = (name if name == column else f"{name} = {column}" for name, column in recording.error_columns.items())
    used = "each one" if request.every_measurement else "those that the controller requested"
    talc = asdict(sections.talc)
    own = {name: value for name, value in talc.items() if not isinstance(value, dict)}
    tables = [("", own), *((f".{name}", value) for name, value in talc.items() if isinstance(value, dict))]
    return (
        ("file", f"{file.name}, {file.stat().st_size} bytes, SHA-256 {recording.sha256}"),
        ("command", request.command()),
        ("errors", ", ".join(errors)),
        ("columns left out", ", ".join(name or "the first, without a name" for name in recording.ignored) or "none"),
        *((("reading", "; ".join(recording.notes)),) if recording.notes else ()),
        ("measurements used", used),
        ("calibration", calibration),
        ("settings", "the defaults" if config is None else f"{config.name}, SHA-256 {_sha256(config)}"),
        *(() if prior is None else (("prior", f"SHA-256 {prior.content_hash}"),)),
        ("[grid]", f"step_s = {sections.grid.step_s:g}"),
        *((f"[talc{part}]", ", ".join(f"{k} = {json.dumps(v)}" for k, v in keys.items())) for part, keys in tables),
    )


def _sha256(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()
