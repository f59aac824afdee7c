"""Sparse output-error models, with scikit-learn's conventions."""

from typing import Literal

from talc.estimators.trained import TrainedModels


class SparseOutputError(TrainedModels):
    """Output-error models that best predict blocks of rows which their fit has not seen: `method = "models"`'s default.

    Parameters
    ----------
    max_na : int
        Largest number of poles, 0 to 3.
    max_nb, max_inputs, step_s, unit_um
        As of `GroupLassoARX`.
    judged_by : {'unseen', 'seen'}
        A BIC of the residuals on rows left out of the fit, or on all rows.

    Attributes
    ----------
    inputs_, poles_, static_gains_, error_names_, feature_names_in_, n_features_in_, step_s_
        As of `GroupLassoARX`.
    """

    _selector = "search"

    def __init__(
        self,
        *,
        max_na: int = 1,
        max_nb: int = 5,
        max_inputs: int = 8,
        judged_by: Literal["unseen", "seen"] = "unseen",
        step_s: float | None = None,
        unit_um: float = 1.0,
    ) -> None:
        self.max_na, self.max_nb, self.max_inputs = max_na, max_nb, max_inputs
        self.judged_by, self.step_s, self.unit_um = judged_by, step_s, unit_um
