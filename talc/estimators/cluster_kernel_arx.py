"""ARX models by the Time Series Cluster Kernel, with scikit-learn's conventions."""

from typing import Literal

from talc.estimators.trained import TrainedModels


class ClusterKernelARX(TrainedModels):
    """ARX models whose inputs the Time Series Cluster Kernel chooses one by one (Zimmermann et al. 2022, §2).

    Parameters
    ----------
    max_na, max_nb, max_inputs, estimator, seed, step_s, unit_um
        As of `GroupLassoARX`; the seed is of the kernel's ensemble.

    Attributes
    ----------
    inputs_, poles_, static_gains_, error_names_, feature_names_in_, n_features_in_, step_s_
        As of `GroupLassoARX`.
    """

    _selector = "tck"

    def __init__(
        self,
        *,
        max_na: int = 1,
        max_nb: int = 5,
        max_inputs: int = 8,
        estimator: Literal["least_squares", "guarded", "refined"] = "guarded",
        seed: int = 0,
        step_s: float | None = None,
        unit_um: float = 1.0,
    ) -> None:
        self.max_na, self.max_nb, self.max_inputs = max_na, max_nb, max_inputs
        self.estimator, self.seed, self.step_s, self.unit_um = estimator, seed, step_s, unit_um
