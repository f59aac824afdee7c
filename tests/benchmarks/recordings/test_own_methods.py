"""METHODS of the recordings' benchmark: the user's own classes, those that cannot be made, and those that peek."""

import re
from pathlib import Path

import numpy as np
import pytest

from benchmarks.recordings.causal import trial
from benchmarks.recordings.chosen import methods
from benchmarks.recordings.description import InputColumn
from benchmarks.recordings.series import Series

PAGE = Path(__file__).parents[3] / "docs" / "recordings.md"


def series() -> Series:
    nothing = np.zeros((30, 1))
    number, none = np.zeros(1), np.zeros(30, dtype=np.int64)
    return Series(
        "s", 300.0, np.arange(30), none, ("t",), (InputColumn(),), nothing, ("e",), ("um",),
        np.zeros(1, dtype=np.bool_), nothing, number, number, (),
    )  # fmt: skip


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.syspath_prepend(str(tmp_path))
    return tmp_path


@pytest.mark.slow
def test_the_example_of_the_page_runs_and_learns(own: Path) -> None:
    example = re.findall(r"```python\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)[-1]
    (own / "my_module.py").write_text(example, encoding="utf-8")
    chosen = methods(series(), "my_module:MyMethod")
    assert [method.name for method in chosen] == ["none", "hold", "learner", "support vectors"]
    given = trial()
    (course,) = chosen[-1].courses(given)
    assert np.nanmean((course.estimate - given.measured) ** 2) < 0.2 * np.nanmean(given.measured**2)


def test_named_methods_take_the_place_of_the_usual_ones(own: Path) -> None:
    (own / "own_hold.py").write_text(
        "from benchmarks.recordings.methods import HoldLast\n\nclass Own(HoldLast):\n    pass\n", encoding="utf-8"
    )
    assert [type(method).__name__ for method in methods(series(), "own_hold:Own,hold")] == ["HoldLast", "Own"]


_OWN = """import numpy as np
from benchmarks.recordings.methods import MethodCourse

class Own:
    name = "own"

    def courses(self, given):
        estimate = {estimate}
        return [MethodCourse(estimate, np.full(estimate.shape, np.nan))]
"""


@pytest.mark.parametrize(
    ("module", "estimate", "expected"),
    [
        ("own_late", "given.measured.copy()", "own: an estimate up to row"),
        ("own_mean", "np.full(given.measured.shape, np.nanmean(given.measured))", "own: an estimate up to row"),
        ("own_flat", "np.zeros(len(given.k))", "estimate has shape (150,)"),
    ],
)
def test_a_class_that_peeks_or_does_not_fit_is_refused(own: Path, module: str, estimate: str, expected: str) -> None:
    (own / f"{module}.py").write_text(_OWN.format(estimate=estimate), encoding="utf-8")
    with pytest.raises(SystemExit, match=re.escape(expected)):
        methods(series(), f"{module}:Own")
