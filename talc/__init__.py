"""Thermal Adaptive Learning Control: the science. Arrays in, arrays out; no I/O, no clock, no logging.

For research: `Learner`, the papers' estimators and `rehearse` (docs/library.md). Others use them, and the modules named
here. All are imported when they are first used: the names of the errors are needed where there is no kernel.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from talc.estimators import ClusterKernelARX, GroupLassoARX, Learner, NotFittedError, SparseOutputError, rehearse

_ESTIMATORS = ("ClusterKernelARX", "GroupLassoARX", "Learner", "NotFittedError", "SparseOutputError", "rehearse")

__all__ = [
    "ClusterKernelARX",
    "GroupLassoARX",
    "Learner",
    "NotFittedError",
    "SparseOutputError",
    "control",
    "explanation",
    "forecast",
    "frame",
    "indicators",
    "kinds",
    "kinematics",
    "learner",
    "load_heat",
    "models",
    "names",
    "papers",
    "planned",
    "presets",
    "probing",
    "rehearse",
    "sensor_check",
    "sensor_model",
    "settings",
    "snapshot",
    "steps",
    "transfer",
    "units",
]


def __dir__() -> list[str]:
    """What completion offers, before anything has been imported."""
    return sorted({*globals(), *__all__})


def __getattr__(name: str) -> object:
    if name in _ESTIMATORS:
        from talc import estimators

        return getattr(estimators, name)
    if name in __all__:
        from importlib import import_module

        return import_module(f"talc.{name}")
    raise AttributeError(f"module 'talc' has no attribute {name!r}")
