"""Both routes from an error's rows to a model find the input and the pole that made the error."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from talc.frame import FloatArray
from talc.papers.routes import Shared, by_arx, by_search
from talc.papers.tck import Ensemble
from talc.papers.window import Window
from talc.settings import TrainingSettings

POLE, NOISE = 0.9, 0.02
SETTINGS = TrainingSettings(selector="pso", estimator="least_squares", max_na=1, max_nb=1, max_inputs=3)


def unused() -> Ensemble:
    raise AssertionError("no clusters are asked for")


@pytest.fixture
def rows() -> tuple[FloatArray, FloatArray]:
    """Three inputs that wander, and the response of first order to the second one, both scaled."""
    draw = np.random.default_rng(3)
    u = lfilter([1.0], [1.0, -0.98], draw.normal(size=(600, 3)), axis=0)
    y = lfilter([1.0 - POLE], [1.0, -POLE], u[:, 1])
    u, y = (u - u.mean(0)) / u.std(0), (y - y.mean()) / y.std()
    return u, y + NOISE * draw.normal(size=len(y))


def test_the_search_finds_the_input_and_its_pole(rows: tuple[FloatArray, FloatArray]) -> None:
    u, y = rows
    shared = Shared(u, np.isfinite(y), {"EX0C": y}, [(), (0.5,), (POLE,), (0.99,)], lags=2)
    found = by_search(shared, "EX0C", None, SETTINGS)
    assert 1 in found.inputs
    assert found.parameters.a.tolist() == [-POLE]
    assert found.residual.std() < 2 * NOISE
    assert not found.resets_history


def test_the_search_keeps_the_inputs_that_are_given(rows: tuple[FloatArray, FloatArray]) -> None:
    u, y = rows
    shared = Shared(u, np.isfinite(y), {"EX0C": y}, [(POLE,)], lags=2)
    assert by_search(shared, "EX0C", (0, 1), SETTINGS).inputs == (0, 1)


def test_the_papers_route_finds_the_input_and_its_pole(rows: tuple[FloatArray, FloatArray]) -> None:
    u, y = rows
    found = by_arx(Window(u, y, y, 1.0), None, "EX0C", SETTINGS, unused)
    assert 1 in found.inputs
    assert found.parameters.a[0] == pytest.approx(-POLE, abs=0.05)
    assert found.residual.std() < 3 * NOISE
    assert found.resets_history


def test_the_papers_route_refuses_a_pole_beyond_the_limit(rows: tuple[FloatArray, FloatArray]) -> None:
    u, y = rows
    with pytest.raises(ValueError, match=r"a pole of magnitude 0\.[89]\d+, expected less than 0\.5"):
        by_arx(Window(u, y, y, 1.0), None, "EX0C", replace(SETTINGS, max_pole=0.5), unused)
