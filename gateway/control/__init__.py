"""The grid loop around the pure controller, training and the sensor check.

Others use the modules named here; this one imports none of them, as the process that `subprocess` starts needs little.
"""

__all__ = ["grid", "loop", "sensor_watch", "trainer"]
