"""The notebooks of `examples/notebooks`: each `.ipynb` is made, with its outputs, from the `.py` file beside it.

`python -m tests.benches.notebooks` makes them again. A `.py` file has cells in the percent format (`# %%`,
`# %% [markdown]`), which Jupyter, VS Code and PyCharm also read. It is the source, because it can be read, linted and
compared; the `.ipynb` is for readers without such an editor, and for the site. Outputs are what the cells print. Making
them does not need Jupyter, whose 40 packages would serve only this.
"""

import io
import json
import re
from collections.abc import Iterator, Sequence
from contextlib import chdir, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "examples" / "notebooks"
_MARK = re.compile(r"(?m)^# %%(?: \[(markdown)\])?\n")


@dataclass(frozen=True, slots=True)
class NotebookCell:
    """One cell of a source."""

    is_code: bool
    text: str


def sources() -> list[Path]:
    return sorted(FOLDER.glob("*.py"))


def cells(text: str) -> Iterator[NotebookCell]:
    """The cells of a source in the percent format."""
    _, *parts = _MARK.split(text)
    for kind, body in zip(parts[::2], parts[1::2], strict=True):
        lines = body.strip("\n").split("\n")
        if kind:
            lines = [line.removeprefix("#").removeprefix(" ") for line in lines]
        yield NotebookCell(not kind, "\n".join(lines))


def run(cells: Sequence[NotebookCell]) -> tuple[list[str], dict[str, Any]]:
    """What each cell prints, empty for text, and the names that are defined at the end.

    The cells run in the folder of the notebooks, as in Jupyter.
    """
    names: dict[str, Any] = {"__name__": "__main__"}
    printed = []
    for number, cell in enumerate(cells):
        said = io.StringIO()
        if cell.is_code:
            with chdir(FOLDER), redirect_stdout(said):
                exec(compile(cell.text, f"<cell {number}>", "exec"), names)
        printed.append(said.getvalue())
    return printed, names


def notebook(cells: Sequence[NotebookCell], printed: Sequence[str]) -> str:
    """The `.ipynb` (nbformat 4.5) of these cells and what they printed."""
    made: list[dict[str, object]] = []
    count = 0
    for number, (cell, said) in enumerate(zip(cells, printed, strict=True)):
        one: dict[str, object] = {"cell_type": "code" if cell.is_code else "markdown", "id": f"cell-{number}"}
        if cell.is_code:
            count += 1
            output = {"name": "stdout", "output_type": "stream", "text": said.splitlines(keepends=True)}
            one |= {"execution_count": count, "outputs": [output] if said else []}
        made.append(one | {"metadata": {}, "source": cell.text.splitlines(keepends=True)})
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    whole = {
        "cells": made,
        "metadata": {"kernelspec": kernel, "language_info": {"name": "python"}},
        "nbformat": 4,
        "nbformat_minor": 5,
    }
    return json.dumps(whole, indent=1, ensure_ascii=False) + "\n"


def main() -> None:
    for source in sources():
        found = list(cells(source.read_text(encoding="utf-8")))
        printed, _ = run(found)
        source.with_suffix(".ipynb").write_text(notebook(found, printed), encoding="utf-8")
        print(f"{source.with_suffix('.ipynb')} made")


if __name__ == "__main__":
    main()
