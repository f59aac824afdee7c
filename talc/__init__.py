"""Thermal Adaptive Learning Control: the science. Arrays in, arrays out; no I/O, no clock, no logging.

Others use the modules named here. None is imported: the names of the errors are needed where there is no kernel.
"""

__all__ = [
    "arx",
    "control",
    "frame",
    "indicators",
    "kinematics",
    "learner",
    "models",
    "names",
    "presets",
    "probing",
    "sensor_check",
    "sensor_model",
    "settings",
    "snapshot",
    "training",
    "window",
]
