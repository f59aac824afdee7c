"""The three-body machine (base, column, spindle) of the ARX, FIR and static comparison. See docs/plant.md."""

from simulators.three_body.model import DRIFTS, SOURCES, THERMOMETERS, load_reduced

__all__ = ["DRIFTS", "SOURCES", "THERMOMETERS", "load_reduced"]
