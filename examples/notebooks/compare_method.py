# %% [markdown]
# # Compare a method of your own
#
# A method is an object with `partial_fit(X, y)` and `predict(X)`. Here a ridge regression on all inputs, measure-and-
# hold, and talc's learner see the same rows of FL_THERMAL (benchmarks/recordings/fl_thermal), one after the other: each
# predicts a row before it may learn from it, and is measured once an hour.

# %%
from pathlib import Path

import numpy as np
import pandas as pd

import talc

table = pd.read_csv(Path("../../benchmarks/recordings/fl_thermal/fl_thermal.csv"))
X = table.filter(regex=r"^(spindle|t\d)").to_numpy()
errors = table.filter(regex="^ch").to_numpy()
measured = np.where((np.arange(len(table)) % 12 == 0)[:, None], errors, np.nan)


# %%
class Hold:
    """The last measurement stays."""

    def partial_fit(self, X, y):
        for row in y[np.isfinite(y).all(axis=1)]:
            self.last = row

    def predict(self, X):
        return np.repeat(self.last[None], len(X), axis=0)


class Ridge:
    """Your method here: a regression on the inputs' deviations, fitted again at every measurement."""

    def __init__(self, penalty):
        self.penalty, self.X, self.y = penalty, [], []

    def partial_fit(self, X, y):
        known = np.isfinite(y).all(axis=1)
        if not known.any():
            return
        self.X += list(X[known])
        self.y += list(y[known])
        rows = np.array(self.X) - self.X[0]
        shift = np.eye(rows.shape[1]) * self.penalty
        self.gain = np.linalg.solve(rows.T @ rows + shift, rows.T @ (np.array(self.y) - self.y[0]))

    def predict(self, X):
        return self.y[0] + (X - self.X[0]) @ self.gain


# %%
def run(method):
    """What was left of each error, row by row."""
    left = np.full(errors.shape, np.nan)
    for k in range(len(X)):
        if k:
            left[k] = errors[k] - method.predict(X[k : k + 1])[0]
        method.partial_fit(X[k : k + 1], measured[k : k + 1])
    return left[1:]


methods = {"hold": Hold(), "ridge 1": Ridge(1.0), "ridge 100": Ridge(100.0), "learner": talc.Learner()}
remains = {"no correction": errors[1:]} | {name: run(method) for name, method in methods.items()}
summary = {}
for name, left in remains.items():
    summary[name] = {"RMSE, µm": round(talc.indicators.rms(left), 2), "P99, µm": round(talc.indicators.p99(left), 1)}
print(pd.DataFrame(summary).T)

# %% [markdown]
# One recording says little. `make bench SUBJECTS=recordings RECORDINGS=folder` compares methods on many, at several
# intervals, with hold and the best ridge in hindsight beside them (docs/recordings.md).
