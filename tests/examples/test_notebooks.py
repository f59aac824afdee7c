"""The notebooks: each `.ipynb` is its source, runs without a network, and shows what its cells print."""

import json
import re
from pathlib import Path
from typing import Any

import pytest

from tests.benches.notebooks import NotebookCell, cells, notebook, run, sources

NAMES = ("compare_method", "own_recording", "repeat_table")
SOURCES = {source.stem: source for source in sources()}
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?")
DIVERGED = 1e3
"""µm; how far an unstable model gets depends on the processor."""


def read(source: Path) -> list[NotebookCell]:
    return list(cells(source.read_text(encoding="utf-8")))


def shown(source: Path) -> list[str]:
    """What each cell of the `.ipynb` has printed."""
    made: dict[str, Any] = json.loads(source.with_suffix(".ipynb").read_text(encoding="utf-8"))
    return ["".join(t for output in cell.get("outputs", ()) for t in output["text"]) for cell in made["cells"]]


def test_there_are_three_with_cells_of_text_and_code() -> None:
    assert tuple(SOURCES) == NAMES
    for source in SOURCES.values():
        found = read(source)
        assert found[0].text.startswith("# ")
        assert {cell.is_code for cell in found[:2]} == {True, False}
        assert "# %%" not in "".join(cell.text for cell in found)


@pytest.mark.parametrize("name", NAMES)
def test_each_notebook_is_its_source(name: str) -> None:
    source = SOURCES[name]
    again = "python -m tests.benches.notebooks makes it again"
    assert source.with_suffix(".ipynb").read_text(encoding="utf-8") == notebook(read(source), shown(source)), again
    assert any(shown(source))


def words(text: str) -> list[str]:
    return NUMBER.sub("0", text).split()


def numbers(text: str) -> list[float]:
    return [float(number) for number in NUMBER.findall(text)]


def more_measurements_leave_less(table: Any) -> None:
    assert list(table.sort_values("measurements").index) == ["fixed", "uncertainty", "every"]
    assert table.sort_values("measurements")["RMSE, µm"].is_monotonic_decreasing
    assert (table["RMSE, µm"] < 0.25 * table["no correction, µm"]).all()


def methods_stand_beside_each_other(summary: Any) -> None:
    rmse = {name: row["RMSE, µm"] for name, row in summary.items()}
    assert list(rmse) == ["no correction", "hold", "ridge 1", "ridge 100", "learner"]
    assert rmse["learner"] < rmse["hold"] < rmse["no correction"]


CLAIMS = {
    "own_recording": more_measurements_leave_less,
    "compare_method": methods_stand_beside_each_other,
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CLAIMS)
def test_a_notebook_shows_what_it_prints(name: str) -> None:
    """That of repeat_table, a paper's study, takes half a minute: `python -m tests.benches.notebooks` runs it."""
    source = SOURCES[name]
    printed, names = run(read(source))
    now, then = ("\n".join(told).split("\n`python -m")[0] for told in (printed, shown(source)))  # below: date and time
    assert words(now) == words(then)
    for found, expected in zip(numbers(now), numbers(then), strict=True):
        if abs(expected) < DIVERGED:
            assert found == pytest.approx(expected, rel=0.1, abs=0.1), name
    CLAIMS[name](names["summary"])
