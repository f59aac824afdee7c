"""Time and memory of importing and training, each in a fresh interpreter."""

import statistics
import subprocess
import sys

from benchmarks.rows import BenchRow

# Not getrusage: there a child's peak starts with its parent's memory at the fork.
_PEAK = "print([int(x.split()[1]) / 1024 for x in open('/proc/self/status') if x.startswith('VmHWM')][0])"
_TRAIN = """
import numpy as np
from talc.frame import TrainingJob, Why
from talc.settings import TrainingSettings
from talc.papers.training import train
draw = np.random.default_rng(0)
rows = {rows}
inputs = np.cumsum(draw.normal(0, 0.1, (rows, 36)), axis=0)
measured = inputs[:, :9] + draw.normal(0, 0.5, (rows, 9))
job = TrainingJob(0, Why.CALIBRATION, tuple(f"u{{i}}" for i in range(36)), inputs, np.ones((rows, 36), bool), measured,
                  TrainingSettings(selector="{selector}", max_na={na}, max_nb={nb}, estimator="{estimator}"))
train(job)
"""
_IMPORT = (
    "import time; t = time.perf_counter(); import talc.control, talc.papers.training; print(time.perf_counter() - t)"
)


def _printed(code: str) -> float:
    return float(subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout)


def rows() -> list[BenchRow]:
    """Peak memory above an interpreter that has imported NumPy, and the time to import talc."""
    plain = _printed(f"import numpy\n{_PEAK}")
    table = []
    for text, rows_, selector, na, nb, estimator in (
        ("`search`, 24 h", 288, "search", 1, 5, "guarded"),
        ("`search`, 340 h", 4080, "search", 1, 5, "guarded"),
        ("`pso` 40 × 60, 24 h, fitted by least squares", 288, "pso", 5, 5, "least_squares"),
        ("`pso` 40 × 60, 24 h, guarded", 288, "pso", 5, 5, "guarded"),
    ):
        code = _TRAIN.format(rows=rows_, selector=selector, na=na, nb=nb, estimator=estimator) + _PEAK
        table.append(BenchRow(f"peak memory of {text} above NumPy", f"{_printed(code) - plain:.0f} MB"))
    after_numpy = statistics.median(_printed(f"import numpy; {_IMPORT}") for _ in range(5))
    whole = statistics.median(_printed(_IMPORT) for _ in range(5))
    table.append(BenchRow("import of talc", f"{whole:.2f} s", f"{after_numpy:.2f} s after NumPy"))
    return table
