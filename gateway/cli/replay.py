"""`talc-gateway replay`."""

from pathlib import Path

from rich.console import Console
from rich.progress import Progress

from gateway.replay import replay
from gateway.store import History


def show(database: Path) -> bool:
    """Replay with a progress bar and say what was found; True when everything was identical."""
    console = Console()
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
