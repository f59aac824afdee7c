"""Training finds what made the record, predicts unseen rows, and never returns an unusable model."""

from concurrent.futures import ThreadPoolExecutor
from typing import Literal

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from talc.frame import TrainingJob, Why
from talc.kinds import EventCode
from talc.models import ModelSet
from talc.papers.free_running import FreeRunningModel
from talc.papers.output_error import Design, fit
from talc.papers.training import train
from talc.settings import TrainingSettings
from tests.benches.thermal_series import ThermalSeries, series

Array = NDArray[np.float64]


def job(s: ThermalSeries, rows: slice = slice(None), **changes: object) -> TrainingJob:
    fields: dict[str, object] = {
        "k": 1000,
        "why": Why.CALIBRATION,
        "input_names": s.names,
        "inputs": s.inputs[rows],
        "valid": np.ones(s.inputs[rows].shape, dtype=np.bool_),
        "measured": s.measured[rows],
        "settings": TrainingSettings(),
    }
    return TrainingJob(**(fields | changes))  # type: ignore[arg-type]


def unseen_rmse(models: ModelSet, s: ThermalSeries, start: int) -> Array:
    """Free run over rows from `start` on, without any measurement there, against the truth."""
    result = np.full(9, np.nan)
    for e, model in enumerate(models.models):
        assert model is not None
        columns = [s.names.index(n) for n in model.inputs]
        measured = s.measured[:, e].copy()
        measured[start:] = np.nan
        predicted = model.free_run(s.inputs[:, columns], measured)
        result[e] = np.sqrt(np.mean((predicted[start:] - s.truth[start:, e]) ** 2))
    return result


def test_predicts_two_unseen_days_within_the_probing_noise() -> None:
    s = series(864, seed=3)
    error = unseen_rmse(train(job(s, slice(0, 288))), s, 288)
    spread = s.truth[288:].std(axis=0)
    assert (error < 0.5 * spread).all(), (error, spread)
    assert np.median(error) < 0.5  # the noise of one measurement


def test_the_pole_survives_the_probing_noise() -> None:
    # One-step least squares on such data finds 0.7 instead of 0.95 and forgets too fast.
    s = series(600, seed=5, pole=0.95)
    poles = [abs(m.poles()).max() for m in train(job(s)).models if m is not None and m.na]
    assert len(poles) == 9
    assert np.median(poles) >= 0.95


def test_irregular_measurements_are_enough() -> None:
    s = series(864, seed=4)
    sparse_rows = np.arange(288) % 6 != 0
    s.measured[:288][sparse_rows] = np.nan
    assert np.median(unseen_rmse(train(job(s, slice(0, 288))), s, 288)) < 1.0


@pytest.mark.slow
def test_the_same_job_gives_the_same_models_bit_for_bit() -> None:
    s = series(288, seed=6)
    assert train(job(s)).fingerprint() == train(job(s)).fingerprint()


@pytest.mark.slow
def test_order_of_inputs_does_not_matter() -> None:
    s = series(400, seed=7)
    turned = ThermalSeries(s.names[::-1], s.inputs[:, ::-1].copy(), s.truth, s.measured)
    for a, b in zip(train(job(s)).models, train(job(turned)).models, strict=True):
        assert a is not None
        assert b is not None
        assert set(a.inputs) == set(b.inputs)


def test_inputs_that_tell_nothing_are_not_offered() -> None:
    s = series(300, seed=8)
    s.inputs[:, 2] = 21.0  # constant
    s.inputs[:100, 5] = np.nan
    valid = np.isfinite(s.inputs)
    valid[:200, 7] = False  # a third good
    models = train(job(s, valid=valid))
    used = {name for m in models.models if m is not None for name in m.inputs}
    assert used.isdisjoint({"t2", "t5", "t7"})
    assert sorted(str(note.values["input"]) for note in models.notes) == ["t5", "t7"]


def test_too_little_gives_no_model_and_says_so() -> None:
    s = series(60, seed=9)
    s.measured[20:, 4] = np.nan
    models = train(job(s))
    assert models.models[4] is None
    assert [(note.code, note.values["error"], note.values["rows"]) for note in models.notes] == [
        (EventCode.TOO_LITTLE_MEASURED, "EZ0T", 20)
    ]
    assert models.models[0] is not None


def test_every_pole_is_stable_and_below_the_bound() -> None:
    s = series(300, seed=11)
    models = train(job(s, settings=TrainingSettings(max_pole=0.9)))
    assert all(abs(p) < 0.9 for m in models.models if m is not None for p in m.poles())


def test_output_error_fit_recovers_a_transfer_function() -> None:
    draw = np.random.default_rng(4)
    u = draw.normal(size=(400, 2))
    y = lfilter([0.3, 0.2], [1.0, -0.9], u[:, 0]) + lfilter([-0.5], [1.0, -0.9], u[:, 1]) + 2.0
    y = y + 5.0 * 0.9 ** np.arange(400)  # an unknown state before the record
    rows = draw.random(400) < 0.3
    design = Design.make(u, (0.9,), 2, rows)
    found = fit(design, (2, 2), y[rows], 1e-14, 6)
    np.testing.assert_allclose(found.b, [[0.3, 0.2], [-0.5, 0.0]], atol=1e-5)
    assert found.constant == pytest.approx(2.0, abs=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("selector", ["pso", "tck"])
@pytest.mark.parametrize("estimator", ["least_squares", "guarded", "refined"])
def test_the_papers_ways_predict_and_stay_stable(selector: str, estimator: str) -> None:
    s = series(864, seed=3)
    s.measured[:, 4:] = np.nan  # four errors are enough here
    settings = TrainingSettings(selector=selector, estimator=estimator, max_na=2, max_nb=1)  # type: ignore[arg-type]
    models = train(job(s, slice(0, 288), settings=settings))
    assert models.fingerprint() == train(job(s, slice(0, 288), settings=settings)).fingerprint()
    left = []
    for e, model in enumerate(models.models[:4]):
        assert model is not None
        assert model.resets_history
        assert (np.abs(model.poles()) < 0.999).all()
        columns = [s.names.index(n) for n in model.inputs]
        measured = np.where(np.arange(864) % 24 == 0, s.measured[:, e], np.nan)
        error = model.free_run(s.inputs[:, columns], measured)[288:] - s.truth[288:, e]
        left.append(np.sqrt(np.mean(error**2)) / s.truth[288:, e].std())
    assert np.median(left) < 0.6, left


@pytest.mark.slow
@pytest.mark.parametrize("selector", ["pso", "tck"])
def test_the_papers_ways_know_the_inputs_that_they_were_trained_with(selector: str) -> None:
    s = series(400, seed=6)
    settings = TrainingSettings(selector=selector, max_na=2, max_nb=1)  # type: ignore[arg-type]
    found = [m for m in train(job(s, slice(0, 300), settings=settings)).models if m is not None and m.inputs]
    assert found
    for model in found:
        running = FreeRunningModel(model, [s.names.index(name) for name in model.inputs])
        seen = [running.step(row, np.nan) for row in s.inputs[:300]]
        assert max(e.novelty for e in seen) == pytest.approx(1.0)  # the largest of training, wherever it was
        hot = s.inputs[300:].copy()
        hot[:, [s.names.index(name) for name in model.inputs]] += 8.0 * model.u_std
        strange = [running.step(row, np.nan) for row in hot]
        assert strange[-1].novelty > 1.0
        assert strange[-1].sigma > seen[-1].sigma


def test_without_measured_predecessors_the_papers_ways_say_what_they_lack() -> None:
    s = series(288, seed=3)
    s.measured[::2] = np.nan
    models = train(job(s, settings=TrainingSettings(selector="pso", max_na=1)))
    assert models.models == (None,) * 9
    assert {note.code for note in models.notes} == {EventCode.NOT_FITTED}
    assert "rows: expected at least 2 with all earlier outputs measured" in str(models.notes[0].values["why"])


@pytest.mark.slow
def test_threads_and_solver_seeds_change_nothing() -> None:
    s = series(288, seed=6)
    jobs = [job(s, settings=TrainingSettings(seed=seed)) for seed in range(3)]
    with ThreadPoolExecutor(3) as pool:
        prints = [models.fingerprint() for models in pool.map(train, jobs)]
    assert set(prints) == {train(jobs[0]).fingerprint()}


@pytest.mark.slow
def test_a_masked_row_never_matters() -> None:
    s = series(288, seed=8)
    s.measured[40:90] = np.nan
    other = ThermalSeries(s.names, s.inputs, s.truth, s.measured.copy())
    other.measured[40:90] = np.inf  # not a measurement either
    assert train(job(s)).fingerprint() == train(job(other)).fingerprint()


def test_an_almost_integrating_plant_gets_a_stable_model() -> None:
    s = series(864, seed=12, pole=0.9995)
    models = train(job(s, slice(0, 288)))
    for e, model in enumerate(models.models):
        assert model is not None
        assert (np.abs(model.poles()) < 0.999).all()
        columns = [s.names.index(n) for n in model.inputs]
        measured = np.where(np.arange(864) % 24 == 0, s.measured[:, e], np.nan)
        left = model.free_run(s.inputs[:, columns], measured)[288:] - s.truth[288:, e]
        assert np.sqrt(np.mean(left**2)) < 1.0  # two sigmas of a measurement


@pytest.mark.parametrize("rows", [0, 1])
def test_no_or_one_measurement_gives_no_model_and_says_so(rows: int) -> None:
    s = series(288, seed=9)
    s.measured[rows:] = np.nan
    models = train(job(s))
    assert models.models == (None,) * 9
    assert {(note.code, note.values["rows"]) for note in models.notes} == {(EventCode.TOO_LITTLE_MEASURED, rows)}


def test_impossible_designs_and_fits_are_refused() -> None:
    u, rows = np.random.default_rng(0).normal(size=(50, 1)), np.ones(50, dtype=np.bool_)
    with pytest.raises(ValueError, match="poles = "):
        Design.make(u, (0.9, 0.9), 1, rows)
    with pytest.raises(ValueError, match="poles = "):
        Design.make(u, (1.0,), 1, rows)
    with pytest.raises(ValueError, match="blocks = 1"):
        fit(Design.make(u, (0.9,), 1, rows), (1,), u[:, 0], 1e-4, 1)


@pytest.mark.slow
def test_measurements_here_and_there_after_a_dense_stretch_count_for_arx_models() -> None:
    """As in the running control: all steps of a day, then one in 24. Their earlier outputs are the model's own."""
    settings = TrainingSettings(selector="pso", max_na=1, max_nb=1, estimator="least_squares")
    ratios = []
    for seed in range(20, 24):
        s = series(1152, seed=seed)
        sparse, dense = s.measured.copy(), s.measured.copy()
        sparse[288:][np.arange(864) % 24 > 0] = np.nan
        dense[288:] = np.nan
        both, first = (
            unseen_rmse(train(job(s, slice(0, 864), settings=settings, measured=m[:864])), s, 864)
            for m in (sparse, dense)
        )
        ratios.append(both / first)
    assert np.exp(np.log(ratios).mean()) < 0.95


@pytest.mark.parametrize("estimator", ["guarded", "least_squares"])
def test_rows_two_steps_apart_are_fitted_to_what_was_estimated_between_them(
    estimator: Literal["guarded", "least_squares"],
) -> None:
    """As in B19's no-good phase. Least squares on the same rows, written out, agree."""
    s = series(300, seed=4)
    s.measured[120:][::2] = np.nan
    settings = TrainingSettings(selector="tck", estimator=estimator, max_na=1, max_nb=0, static_inputs=True)
    keep = tuple((name,) for name in s.names[:9])
    estimated = np.where(np.isfinite(s.measured), np.nan, s.truth + 0.3)
    with_estimates = train(job(s, settings=settings, static_inputs=keep, estimated=estimated)).models
    before = np.where(np.isfinite(s.measured), s.measured, s.truth + 0.3)[:-1]
    rows = np.flatnonzero(np.isfinite(s.measured[1:, 0]))
    for e, model in enumerate(with_estimates):
        assert model is not None
        x = np.column_stack([np.ones(len(rows)), before[rows, e], s.inputs[rows + 1, e]])
        _, pole, _ = np.linalg.lstsq(x, s.measured[rows + 1, e], rcond=None)[0]
        assert model.a == pytest.approx([-pole], abs=1e-4)


def test_an_error_without_kept_inputs_has_them_chosen() -> None:
    s = series(400, seed=6)
    keep = (None, *((s.names[e], s.names[e + 3]) for e in range(1, 9)))
    models = train(job(s, static_inputs=keep)).models
    assert [m.inputs for m in models[1:] if m is not None] == list(keep[1:])
    assert models[0] is not None
    assert set(models[0].inputs) & {s.names[0], s.names[3]}


@pytest.mark.parametrize("selector", ["search", "pso"])
def test_static_inputs_stay_and_their_orders_are_renewed(selector: str) -> None:
    s = series(400, seed=6)
    keep = tuple((s.names[e], s.names[e + 3]) for e in range(9))
    settings = TrainingSettings(selector=selector, max_na=2, max_nb=3)  # type: ignore[arg-type]
    models = train(job(s, settings=settings, static_inputs=keep)).models
    assert [m.inputs for m in models if m is not None] == list(keep)
    sizes = [b.size for m in models if m is not None for b in m.b]
    assert np.mean(sizes) < 3  # the truth has one coefficient per input, four were allowed


@pytest.mark.slow
def test_no_selector_takes_more_inputs_than_allowed() -> None:
    s = series(288, seed=6)
    s.measured[:, 2:] = np.nan
    for selector in ("search", "pso", "tck"):
        settings = TrainingSettings(selector=selector, max_inputs=1)
        model = train(job(s, settings=settings)).models[0]
        assert model is not None
        assert len(model.inputs) <= 1
