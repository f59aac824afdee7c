"""ARX models by the Group-LASSO, with scikit-learn's conventions."""

from typing import Literal

from talc.estimators.trained import TrainedModels


class GroupLassoARX(TrainedModels):
    """ARX models whose inputs and orders a particle swarm chooses over the Group-LASSO (Zimmermann et al. 2022, §4).

    Parameters
    ----------
    max_na, max_nb : int
        Largest autoregressive order, 0 to 5, and largest order of an input, 0 to 5.
    max_inputs : int
        Largest number of inputs in a model.
    criterion : {'adapted_bic', 'bic', 'aic', 'mdl'}
        What the swarm minimises, of the free run's residuals (eq. 9).
    tolerance : float or None
        T of the adapted BIC, in the unit of y. None: 5 µm.
    safety : float
        ST of the adapted BIC.
    estimator : {'guarded', 'least_squares', 'refined'}
        The fit of the choice: under constraints on poles and gains; plain (eq. 5); or of the free run.
    seed : int
        Of the swarm.
    step_s : float or None
        Grid step, s. None: the median spacing of the rows' times, or 300 s where they have none.
    unit_um : float
        Size of the unit of y, µm (µm/m): 1000 for errors in mm. The adapted BIC is not free of a scale: with another
        one it chooses other inputs.

    Attributes
    ----------
    inputs_, poles_, static_gains_ : dict
        By error: names of the chosen inputs, poles, and the response to a lasting unit step of each input.
    error_names_, feature_names_in_, n_features_in_, step_s_
        As of `talc.Learner`.

    Examples
    --------
    >>> import numpy as np
    >>> import talc
    >>> X = np.random.default_rng(1).normal(size=(300, 4)).cumsum(axis=0)
    >>> y = np.zeros(300)
    >>> for k in range(1, 300):
    ...     y[k] = 0.8 * y[k - 1] + 2 * X[k, 1]
    >>> model = talc.GroupLassoARX(max_inputs=2).fit(X[:200], y[:200])
    >>> model.inputs_
    {'y0': ('x1',)}
    >>> round(model.static_gains_["y0"]["x1"], 1)
    10.0
    """

    _selector = "pso"

    def __init__(
        self,
        *,
        max_na: int = 1,
        max_nb: int = 5,
        max_inputs: int = 8,
        criterion: Literal["adapted_bic", "bic", "aic", "mdl"] = "adapted_bic",
        tolerance: float | None = None,
        safety: float = 0.75,
        estimator: Literal["least_squares", "guarded", "refined"] = "guarded",
        seed: int = 0,
        step_s: float | None = None,
        unit_um: float = 1.0,
    ) -> None:
        self.max_na, self.max_nb, self.max_inputs = max_na, max_nb, max_inputs
        self.criterion, self.tolerance, self.safety = criterion, tolerance, safety
        self.estimator, self.seed, self.step_s, self.unit_um = estimator, seed, step_s, unit_um
