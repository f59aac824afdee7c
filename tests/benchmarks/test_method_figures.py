"""The figures of docs/method.md, and the numbers beside them."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks import method_figures

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_the_page_says_what_the_figures_show(tmp_path: Path) -> None:
    method_figures.main(tmp_path)
    for name in ("method-day.svg", "method-inputs.svg"):
        assert (tmp_path / name).stat().st_size > 10_000
        assert f"]({name})" in (ROOT / "docs" / "method.md").read_text("utf-8")
    table = np.loadtxt(ROOT / "benchmarks" / "recordings" / "fl_thermal" / "fl_thermal.csv", delimiter=",", skiprows=1)
    error = table[:, 20]
    mean, std, parts = method_figures.followed(table[:, 1:18], error)
    np.testing.assert_allclose(parts.sum(axis=1), mean, atol=1e-9)
    held = error[(np.arange(len(error)) - 1) // 24 * 24]
    assert np.sqrt(np.mean((error - mean) ** 2)) == pytest.approx(4.2, rel=0.1)
    assert np.sqrt(np.mean((error - held)[1:] ** 2)) == pytest.approx(12.6, abs=0.1)
    assert np.mean(np.abs(error - mean)[1:] < 1.96 * std[1:]) == pytest.approx(0.95, abs=0.03)
