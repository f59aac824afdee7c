"""The compiled numerics (talc/kernel/*.hpp). Unchecked: call through the modules that check shapes and finiteness."""

from numpy import float64, int64
from numpy.typing import NDArray

class Runner:
    """One model's state; see talc.models and talc.papers.free_running."""

    def __init__(
        self,
        a: NDArray[float64],
        b: list[list[float]],
        intercept: float,
        u_mean: NDArray[float64],
        u_std: NDArray[float64],
        u_low: NDArray[float64],
        u_high: NDArray[float64],
        y_mean: float,
        y_std: float,
        y_low: float,
        y_high: float,
        resets_history: bool,
        spread: float,
        leverage: NDArray[float64],
        leverage_limit: float,
        novelty_std: float,
        pole: NDArray[float64],
        drift: NDArray[float64],
        noise: float,
        weight: NDArray[float64],
    ) -> None: ...
    def start(self, y: float) -> None: ...
    def step(
        self, inputs: NDArray[float64], measured: float, learn: bool
    ) -> tuple[float, float, float, float, bool]: ...
    def run(
        self, inputs: NDArray[float64], measured: NDArray[float64], learn: bool, predicted: NDArray[float64]
    ) -> None: ...
    def state(self) -> list[list[float]]: ...
    def restore(self, state: list[list[float]]) -> None: ...

def group_lasso(
    gram: NDArray[float64],
    moment: NDArray[float64],
    energy: float,
    first: list[int],
    size: list[int],
    penalty: float,
    tolerance: float,
    limit: int,
    theta: NDArray[float64],
) -> tuple[float, float, int, int]: ...
def search(
    gram: NDArray[float64],
    moment: NDArray[float64],
    energy: NDArray[float64],
    poles: NDArray[int64],
    starts: list[list[list[int]]],
    inputs: int,
    lags: int,
    ridge: float,
    unseen: bool,
    rows: float,
    price: float,
    floor: float,
    most: int,
    fixed_inputs: bool,
) -> tuple[int, list[int], float]: ...
def pso(
    gram: NDArray[float64],
    moment: NDArray[float64],
    energy: NDArray[float64],
    own: NDArray[float64],
    across: NDArray[float64],
    u: NDArray[float64],
    y: NDArray[float64],
    lags: int,
    criterion: int,
    scale: float,
    tolerance: float,
    safety: float,
    least_log_share: float,
    most: int,
    draws: NDArray[float64],
    pull: float,
    inertia_first: float,
    inertia_last: float,
) -> tuple[float, list[int], float, float]: ...
def lag(columns: NDArray[float64], pole: float) -> None: ...
def process_look(
    rows: NDArray[float64],
    squares: NDArray[float64],
    n: int,
    c: NDArray[float64],
    x: NDArray[float64],
    square: float,
    smooth: float,
    inverse: float,
    level: NDArray[float64],
    known: NDArray[float64],
    lower: NDArray[float64],
    z: NDArray[float64],
    v: NDArray[float64],
    mean: NDArray[float64],
    spread: NDArray[float64],
) -> None: ...
def process_append(
    lower: NDArray[float64],
    z: NDArray[float64],
    n: int,
    v: NDArray[float64],
    mean: NDArray[float64],
    spread: NDArray[float64],
    own: NDArray[float64],
    y: NDArray[float64],
) -> None: ...
def process_rebuild(
    rows: NDArray[float64],
    squares: NDArray[float64],
    n: int,
    c: NDArray[float64],
    smooth: float,
    inverse: float,
    level: NDArray[float64],
    known: NDArray[float64],
    own: NDArray[float64],
    y: NDArray[float64],
    lower: NDArray[float64],
    z: NDArray[float64],
) -> None: ...
def process_shares(
    lower: NDArray[float64],
    z: NDArray[float64],
    n: int,
    shares: NDArray[float64],
) -> None: ...
def process_whiten(
    rows: NDArray[float64],
    n: int,
    known: NDArray[float64],
    lower: NDArray[float64],
    whitened: NDArray[float64],
) -> None: ...
