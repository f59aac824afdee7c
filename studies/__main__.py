"""`python -m studies NAME`: runs one of the papers' studies, with a progress bar, and renews its table in a page."""

import os
from pathlib import Path
from shutil import copytree, rmtree

import click
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from studies import STUDIES, carry_out, renew
from studies.frame import Only, chosen


@click.command()
@click.argument("name", required=False)
@click.option("--out", type=click.Path(file_okay=False, path_type=Path), help="Default: out/studies/NAME, NAME-small.")
@click.option("--workers", type=click.IntRange(min=1), help="Number of processes. Default: one per core.")
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True)
@click.option("--small", is_flag=True, help="Only a few runs, to see that it works.")
@click.option("--only", multiple=True, metavar="PARAMETER=VALUE,...",
              help="Only the runs with one of these values, such as repetition=0,1,2.")  # fmt: skip
@click.option("--results", type=click.Path(exists=True, dir_okay=False, path_type=Path), help="File with its table.")
@click.option("--pages", type=click.Path(file_okay=False, path_type=Path), help="Folder with a folder for its page.")
def main(
    name: str | None,
    out: Path | None,
    workers: int | None,
    seed: int,
    small: bool,
    only: tuple[str, ...],
    results: Path | None,
    pages: Path | None,
) -> None:
    """Run the study NAME, or continue it; without NAME list the studies."""
    if name is None:
        for known in STUDIES.values():
            click.echo(f"{known.name:16} {known.summary}")
        return
    if name not in STUDIES:
        raise click.BadParameter(f"{name!r}: expected one of {', '.join(STUDIES)}", param_hint="NAME")
    folder = out or Path("out/studies") / (f"{name}-small" if small else name)
    wanted = {key: values.split(",") for key, _, values in (text.partition("=") for text in only)}
    try:
        chosen(STUDIES[name].runs(seed, small), wanted)
    except ValueError as error:
        raise click.BadParameter(str(error), param_hint="--only") from error
    if not run_study(name, folder, seed, small, workers or os.cpu_count() or 1, results, wanted):
        raise click.BadParameter(
            f"{results}: has no lines <!-- study {name} --> and <!-- end -->", param_hint="--results"
        )
    if pages is not None:
        rmtree(pages / name, ignore_errors=True)
        copytree(folder / "page", pages / name)


def run_study(
    name: str, folder: Path, seed: int, small: bool, workers: int, results: Path | None, only: Only | None = None
) -> bool:
    """Run what is missing in `folder`, write the report and renew the table in `results`; False: it has no place."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # the processes that do the runs share the cores already
    console = Console(markup=False, emoji=False)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    total = 0
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(name, total=None)
        for done, total in carry_out(STUDIES[name], folder, seed, small, workers, only):
            bar.update(task, completed=done, total=total)
    console.print(f"{name}: {total} runs; report: {folder / 'report.html'}", soft_wrap=True)
    return results is None or renew(results, name, (folder / "summary.md").read_text(encoding="utf-8"))


if __name__ == "__main__":
    main()
