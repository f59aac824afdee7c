"""Models by which tests of the controller distinguish one training from another."""

import numpy as np

from talc.models import ErrorModel, ModelSet
from talc.names import THERMAL_ERRORS

INPUTS = ("warm", "idle")


def model(error: str, limit: float = 3.0) -> ErrorModel:
    """y = 2 warm, in physical units, as a first-order lag with pole 0.5."""
    return ErrorModel(
        error=error,
        inputs=("warm",),
        a=np.array([-0.5]),
        b=(np.array([0.5, 0.5]),),
        u_mean=np.zeros(1),
        u_std=np.ones(1),
        y_mean=0.0,
        y_std=1.0,
        u_low=np.full(1, -100.0),
        u_high=np.full(1, 100.0),
        y_low=-300.0,
        y_high=300.0,
        limit=limit,
        training_limit=limit,
        residual_std=1.0,
        criterion=0.0,
    )


def models(k: int, only: tuple[str, ...] = THERMAL_ERRORS) -> ModelSet:
    chosen = tuple(model(e) if e in only else None for e in THERMAL_ERRORS)
    return ModelSet(k=k, why="calibration", input_names=INPUTS, models=chosen)
