"""C dx/dt = -(K + sum h_i H_i) x + G T_zones + q, stepped by the [0/2] Padé approximation: stable for h >= 0."""

import numpy as np

from simulators.plant.body import FloatArray
from simulators.plant.parameters import PlantParameters

FILM_STEPS = 16
"""Film factors are rounded to 1/16: a disc's film is not known better, and the same matrices serve again."""
_REMEMBERED = 128
"""Pairs of matrices, a quarter of a megabyte each."""


class Network:
    """Steps the coordinates. Second order in the step and L-stable, so stiff jackets need no small step."""

    def __init__(self, parameters: PlantParameters) -> None:
        self.parameters = parameters
        self._known: dict[tuple[float, bytes], tuple[FloatArray, FloatArray]] = {}
        self._last: tuple[float, FloatArray | None, tuple[FloatArray, FloatArray]] | None = None

    def rate(self, films: FloatArray) -> FloatArray:
        """(n, n) W/K: K + sum h_i H_i."""
        return self.parameters.conductance + np.tensordot(films, self.parameters.films, axes=1)

    def step(
        self, state: FloatArray, films: FloatArray, heat: FloatArray, zones: FloatArray, dt_s: float
    ) -> FloatArray:
        """State (n,) after dt_s with films (f,), heat (n,) W and zones (z,) degC held over the step."""
        if self._last is None or self._last[0] != dt_s or self._last[1] is not films:
            self._last = dt_s, films, self._propagator(films, dt_s)
        keep, take = self._last[2]
        moved: FloatArray = keep @ state + take @ (heat + self.parameters.outside @ zones)
        return moved

    def steady(self, films: FloatArray, heat: FloatArray, zones: FloatArray) -> FloatArray:
        """State (n,) at which nothing changes any more."""
        answer = np.linalg.solve(self.rate(self._rounded(films)), heat + self.parameters.outside @ zones)
        return np.asarray(answer, dtype=np.float64)

    @staticmethod
    def _rounded(films: FloatArray) -> FloatArray:
        return np.asarray(np.round(films * FILM_STEPS) / FILM_STEPS, dtype=np.float64)

    def _propagator(self, films: FloatArray, dt_s: float) -> tuple[FloatArray, FloatArray]:
        films = self._rounded(films)
        key = (dt_s, films.tobytes())
        if key not in self._known:
            if len(self._known) >= _REMEMBERED:
                self._known.clear()
            c = self.parameters.capacity
            z = dt_s * self.rate(films) / c[:, None]
            eye = np.eye(len(c))
            keep = np.asarray(np.linalg.inv(eye + z + z @ z / 2), dtype=np.float64)
            self._known[key] = keep, keep @ (eye + z / 2) * (dt_s / c)
        return self._known[key]
