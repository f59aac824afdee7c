"""`talc-gateway report`: makes a table and an HTML page from a database and, for a simulation, from the truth."""

import csv
from pathlib import Path

import numpy as np

from gateway.cli.terminal import terminal
from gateway.past import stored_config
from gateway.report import AdoptedModels, ReportData, Truth, build, picture, summary, table
from gateway.storage import History, StoreError
from talc.frame import FloatArray

_TRUTH_COLUMNS = 17
"""Time, nine errors, tool deviation without and with compensation, probing; the last line may be truncated."""


def write(database: Path, output: Path, truth: Path | None = None) -> None:
    """Print the table and write the page, and of a simulation a picture too. Raises StoreError: nothing is stored."""
    data = collect(database, truth)
    console = terminal()
    console.print(table(summary(data)))
    output.write_text(build(data), encoding="utf-8")
    console.print(f"report: {output}", soft_wrap=True)
    if data.truth is not None:
        output.with_suffix(".png").write_bytes(picture(data))


def collect(database: Path, truth: Path | None = None) -> ReportData:
    """All that the report shows, as arrays. Times are seconds since the first frame's instant."""
    with History(database) as history:
        config, found = stored_config(history), history.config()
        steps = list(history.steps())
        if not steps or found is None:
            raise StoreError(f"{database}: holds no frames yet")
        step_s = config.grid.step_s
        k = np.array([s.frame.k for s in steps])
        start = float(k[0]) * step_s
        nothing = np.full(9, np.nan)
        compensation = history.compensation()
        cycles = history.measurements()
        return ReportData(
            machine=config.machine.name,
            fingerprint=found[1],
            versions=found[2],
            step_s=step_s,
            start_utc_s=start,
            k=k,
            phases=tuple(s.decision.phase for s in steps),
            predicted=np.array([s.decision.predicted for s in steps]),
            corrected=np.array([s.decision.corrected for s in steps]),
            sigma=np.array([s.decision.sigma for s in steps]),
            limits=np.array([s.decision.limits for s in steps]),
            measured=np.array([s.frame.measurement.errors if s.frame.measurement else nothing for s in steps]),
            models=tuple(AdoptedModels(s.frame.k, m) for s in steps for m in s.adopted),
            events=tuple((at.timestamp() - start, event) for at, _, event in history.events()),
            compensation_s=np.array([c.time.timestamp() - start for c in compensation]),
            compensation_um=np.array([c.offsets_um for c in compensation]).reshape(-1, 3),
            input_names=config.input_names,
            channel_health=history.channel_health(),
            cycles=len(cycles),
            rejected_cycles=sum(m.errors is None for m in cycles),
            truth=None if truth is None else _truth(truth, start),
            trusted=np.array([s.decision.trusted for s in steps]) if all(s.trust_known for s in steps) else None,
            reasons=history.reasons(),
            not_compared="" if config.sensor_check.enabled else "[sensor_check] enabled = false",
        )


def _truth(path: Path, start_utc_s: float) -> Truth:
    """The emulated machine's own record, on the report's time axis."""
    with path.open(newline="", encoding="ascii") as file:
        rows = list(csv.reader(file))[1:]
    values: FloatArray = np.array([[float(v) for v in row] for row in rows if len(row) == _TRUTH_COLUMNS])
    return Truth(
        time_s=values[:, 0] - start_utc_s,
        errors=values[:, 1:10],
        uncompensated_um=values[:, 10:13],
        compensated_um=values[:, 13:16],
        probing=values[:, 16] > 0,
    )
