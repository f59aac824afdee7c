"""`python -m benchmarks.method_figures`: draws the figures of docs/method.md, from the recording FL_THERMAL.

Given the path of a folder, it writes them there instead of in docs.
"""

import sys
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from talc import Learner
from talc.frame import FloatArray
from talc.indicators import TWO_SIDED_95

_ROOT = Path(__file__).parents[1]
_RECORDING = _ROOT / "benchmarks" / "recordings" / "fl_thermal" / "fl_thermal.csv"
_CHANNEL = 2
"""The axial displacement, ch3."""
_EVERY = 24
"""Steps between two measurements: 2 h."""
_STYLE: dict[Any, Any] = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False, "svg.hashsalt": "talc"}


def main(folder: Path = _ROOT / "docs") -> None:
    """Write both figures."""
    head = _RECORDING.read_text(encoding="utf-8").split("\n", 1)[0].split(",")
    table = np.loadtxt(_RECORDING, delimiter=",", skiprows=1)
    names, inputs, error = head[1:18], table[:, 1:18], table[:, 18 + _CHANNEL]
    hours = table[:, 0] / 3600.0
    with mpl.rc_context(_STYLE):
        mean, std, parts = predicted_before(inputs, error)
        _save(_day(hours, error, mean, std), folder / "method-day.svg")
        _save(_parts(hours, names, parts), folder / "method-inputs.svg")


def predicted_before(inputs: FloatArray, error: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(T,) predictions before each row's measurement and their uncertainties, (T, n + 1) what they consist of."""
    learner = Learner().partial_fit(inputs[:1], error[:1])
    mean, std, parts = [0.0], [0.0], [np.zeros(inputs.shape[1] + 1)]
    for k in range(1, len(error)):
        row = inputs[k : k + 1]
        value, sigma = learner.predict(row, return_std=True)
        mean.append(float(value[0]))
        std.append(float(sigma[0]))
        parts.append(learner.contributions(row)[0, 0])
        learner.partial_fit(row, error[k : k + 1] if k % _EVERY == 0 else np.array([np.nan]))
    return np.array(mean), np.array(std), np.array(parts)


def _day(hours: FloatArray, error: FloatArray, mean: FloatArray, std: FloatArray) -> Figure:
    figure = Figure(figsize=(9, 2.4), layout="constrained")
    axes = figure.subplots()
    low, high = mean - TWO_SIDED_95 * std, mean + TWO_SIDED_95 * std
    axes.fill_between(hours, low, high, color="#dbeafe", lw=0, label="its 95 % interval")
    axes.plot(hours, error, color="#94a3b8", lw=1.6, label="recorded")
    axes.plot(hours, mean, color="#1d4ed8", lw=1.0, label="predicted")
    axes.plot(hours[::_EVERY], error[::_EVERY], ".", color="black", ms=6, label="measured, each 2 h")
    axes.set(xlabel="hours", ylabel="ch3, µm", xlim=(0, hours[-1]), ylim=(error.min() - 15, error.max() + 20))
    axes.legend(ncols=4, fontsize=8, frameon=False, loc="upper left")
    return figure


def _parts(hours: FloatArray, names: list[str], parts: FloatArray) -> Figure:
    figure = Figure(figsize=(9, 2.4), layout="constrained")
    axes = figure.subplots()
    largest = np.argsort(-np.abs(parts[:, :-1]).mean(axis=0), kind="stable")[:5]
    for i in largest.tolist():
        axes.plot(hours, parts[:, i], lw=1.0, label=names[i])
    others = parts[:, :-1].sum(axis=1) - parts[:, largest].sum(axis=1)
    axes.plot(hours, others, color="#94a3b8", lw=1.0, label="all other inputs")
    axes.plot(hours, parts[:, -1], color="black", lw=1.0, ls="--", label="level")
    axes.set(xlabel="hours", ylabel="part of the prediction, µm", xlim=(0, hours[-1]))
    axes.legend(ncols=7, fontsize=8, frameon=False, loc="upper left")
    return figure


def _save(figure: Figure, path: Path) -> None:
    figure.savefig(path, metadata={"Date": None})


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
