"""The compiled numerics (talc/kernel/*.hpp). Unchecked: call through the modules that check shapes and finiteness."""

from numpy import float64
from numpy.typing import NDArray

def free_run(
    a: NDArray[float64],
    drive: NDArray[float64],
    y_measured: NDArray[float64],
    gains: NDArray[float64],
    low: float,
    high: float,
    age: int,
    history: NDArray[float64],
    y_out: NDArray[float64],
) -> int:
    """Simulate in place: `history` (na,) and `y_out` (T,) are written; returns the steps since the last update."""
