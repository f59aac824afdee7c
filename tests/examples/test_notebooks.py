"""The notebooks run, from the checkout's folder, and show what they say."""

import runpy
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
NOTEBOOKS = {file.stem: file for file in (ROOT / "examples" / "notebooks").glob("*.py")}


@pytest.fixture
def executed(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What a notebook leaves behind."""
    monkeypatch.chdir(ROOT)
    return runpy.run_path(str(NOTEBOOKS[request.param]))


def test_there_are_three_with_cells_of_text_and_code() -> None:
    assert sorted(NOTEBOOKS) == ["compare_method", "own_recording", "repeat_table"]
    for file in NOTEBOOKS.values():
        text = file.read_text(encoding="utf-8")
        assert text.startswith("# %% [markdown]\n# # ")
        assert text.count("\n# %%\n") >= 2


@pytest.mark.slow
@pytest.mark.parametrize("executed", ["own_recording"], indirect=True)
def test_more_measurements_leave_less(executed: dict[str, Any]) -> None:
    table = executed["summary"]
    by_count = table.sort_values("measurements")
    assert list(by_count.index) == ["fixed", "uncertainty", "every"]
    assert by_count["RMSE, µm"].is_monotonic_decreasing
    assert (table["RMSE, µm"] < 0.25 * table["no correction, µm"]).all()


@pytest.mark.slow
@pytest.mark.parametrize("executed", ["compare_method"], indirect=True)
def test_methods_stand_beside_each_other(executed: dict[str, Any]) -> None:
    rmse = {name: row["RMSE, µm"] for name, row in executed["summary"].items()}
    assert list(rmse) == ["no correction", "hold", "ridge 1", "ridge 100", "learner"]
    assert rmse["learner"] < rmse["hold"] < rmse["no correction"]


@pytest.mark.slow
@pytest.mark.parametrize("executed", ["repeat_table"], indirect=True)
def test_the_papers_figures_stand_in_the_table(executed: dict[str, Any]) -> None:
    assert "| ARX |" in executed["summary"]
    assert "paper: Y, Z" in executed["summary"]
