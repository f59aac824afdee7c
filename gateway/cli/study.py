"""`talc-gateway study`: a progress bar around the studies that repeat the papers."""

import os
from pathlib import Path

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from gateway.terminal import terminal
from simulators.studies import STUDIES, carry_out, renew


def run_study(name: str, folder: Path, seed: int, small: bool, workers: int, readme: Path | None) -> bool:
    """Run what is missing in `folder`, write its report and renew its table in `readme`; False: no place for it."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # the processes that do the runs share the cores already
    console = terminal()
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    total = 0
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(name, total=None)
        for done, total in carry_out(STUDIES[name], folder, seed, small, workers):
            bar.update(task, completed=done, total=total)
    console.print(f"{name}: {total} runs; report: {folder / 'report.html'}", soft_wrap=True)
    return readme is None or renew(readme, name, (folder / "summary.md").read_text(encoding="utf-8"))
