"""Files that a command writes: never one of those that it reads."""

from pathlib import Path

import click


def page_path(wanted: Path | None, source: Path, *others: Path | None) -> Path:
    """Path of the page to write. Raises UsageError as `check_output`."""
    page = wanted or source.with_suffix(".html")
    check_output("page", "-o", page, source, *others)
    return page


def check_output(what: str, option: str, written: Path | None, *sources: Path | None) -> None:
    """Raises UsageError for a file to be written that is one of its sources, or whose folder does not exist."""
    if written is None:
        return
    if not written.parent.is_dir():
        raise click.UsageError(f"the {what} cannot be written: there is no folder {written.parent}; see {option}")
    for used in sources:
        if used is not None and written.exists() and written.samefile(used):
            raise click.UsageError(f"the {what} would overwrite {used}; give it another name with {option}")
