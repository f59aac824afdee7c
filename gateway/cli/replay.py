"""`talc-gateway replay`: of a store, to prove its decisions; of a user's recording, as if it were live."""

from pathlib import Path

from rich.progress import Progress

from gateway.config.talc_only import TalcOnly, load_talc_only
from gateway.recording import read_recording
from gateway.recording_columns import Columns
from gateway.replay import replay
from gateway.store import History
from gateway.terminal import terminal


def show(database: Path) -> bool:
    """Replay with a progress bar and say what was found; True when everything was identical."""
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


def run_recording(file: Path, columns: Columns, output: Path, config: Path | None, *, every_measurement: bool) -> None:
    """Check the recording, run the controller over it, print the table and write the page."""
    from gateway.rehearsal import rehearse
    from gateway.report import build, summary, table

    sections = TalcOnly() if config is None else load_talc_only(config)
    recording = read_recording(file, columns, sections.grid.step_s)
    console = terminal()
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("replaying", total=len(recording.k))
        data = rehearse(
            recording,
            sections.talc,
            every_measurement=every_measurement,
            progress=lambda steps: bar.update(task, completed=steps),
        )
    found = summary(data)
    if found.rows:
        console.print(table(found))
    else:
        control = sections.talc.control
        console.print(
            f"no figures: {found.basis}; {data.cycles} of {len(data.k)} steps of {data.step_s:g} s hold a measurement. "
            f"Calibration takes {control.calibration_steps} steps, measured each {control.calibration_interval_steps}; "
            "--config with [talc.control] calibration_steps and calibration_interval_steps says otherwise",
            soft_wrap=True,
        )
    output.write_text(build(data), encoding="utf-8")
    console.print(f"report: {output}", soft_wrap=True)
