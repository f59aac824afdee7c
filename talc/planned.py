"""Effects of a planned load on the inputs: temperatures follow loads as they did in the record (talc.load_heat).

The change from now on is the regression's, from the present state of the loads' lags to what the planned load makes of
them: a machine that is already warm from that load warms no further, and one whose load ends cools.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from talc.frame import LEAST_VALID, BoolArray, FloatArray
from talc.load_heat import LoadScale, heat_of, scale_of
from talc.sensor_model import masked
from talc.steps import DAY_S, steps_in

_LEAST_S: Final = 2.0 * DAY_S
_PARTS: Final = 4
"""Consecutive parts of the record, each of which is left out in turn."""
_LEAST_FOLLOWED: Final = 0.9
"""An input follows loads if they reduce its residual on left-out rows to at most this share."""
_FARTHEST: Final = 1.2
"""Beyond this multiple of the largest load that was learnt nothing is foreseen."""


@dataclass(frozen=True, slots=True, eq=False)
class LoadResponse:
    """How m inputs follow L loads."""

    followers: tuple[str, ...]
    scale: LoadScale
    weights: FloatArray
    """(4 L, m) of the loads' features; in the inputs' units."""

    def changes(
        self,
        names: Sequence[str],
        recent: FloatArray,
        valid: BoolArray,
        planned: Mapping[str, float],
        steps: int,
        lasting: int | None = None,
    ) -> FloatArray | None:
        """(steps, n) by how much the inputs `names` will differ from the last row, if the planned loads have their
        values from now on and the other loads stay. None: a planned load has not been learnt, or not as large.

        recent: (T, n) the last consecutive rows, T >= 1; valid: (T, n)
        lasting: after so many steps, at least 1, all loads are again as in the last row; None: they stay as planned
        """
        largest = dict(zip(self.scale.names, self.scale.largest.tolist(), strict=True))
        if any(abs(value) > _FARTHEST * largest.get(name, 0.0) for name, value in planned.items()):
            return None
        recent, valid = masked(names, recent, valid)
        own = [names.index(name) for name in self.scale.names]
        loads, known = recent[:, own], valid[:, own]
        now = np.where(known[-1], loads[-1], 0.0)
        then = np.array([planned.get(name, value) for name, value in zip(self.scale.names, now.tolist(), strict=True)])
        last = self.scale.last_features(loads, known)
        found = np.zeros((steps, len(names)))
        features = self.scale.coming_features(last, then, steps)
        found[:, own] = then - now
        if lasting is not None and lasting < steps:
            features[lasting:] = self.scale.coming_features(features[lasting - 1], now, steps - lasting)
            found[lasting:, own] = 0.0
        found[:, [names.index(name) for name in self.followers]] = (features - last) @ self.weights
        return found


def learn_response(
    names: Sequence[str], inputs: FloatArray, valid: BoolArray, loads: Sequence[str], step_s: float = 300.0
) -> LoadResponse | None:
    """How the other inputs follow the loads. None: no load changed, nothing follows, or less than two days are known.

    inputs: (T, n) consecutive grid steps of step_s, in their units; valid: (T, n). An input with less than 80 % good
    rows, or which loads do not explain in parts of the record that were left out, stays as it is. ValueError: shapes
    that do not fit together.
    """
    inputs, valid = masked(names, inputs, valid)
    driving = [i for i in range(len(names)) if names[i] in loads]
    scale = scale_of([names[i] for i in driving], inputs[:, driving], valid[:, driving], step_s)
    if scale is None:
        return None
    own = [names.index(name) for name in scale.names]
    share = valid.mean(axis=0)
    rest = [i for i in range(len(names)) if names[i] not in loads and share[i] >= LEAST_VALID]
    good = np.asarray(valid[:, own + rest].all(axis=1), dtype=np.bool_)
    if not rest or good.sum() < steps_in(_LEAST_S, step_s):
        return None
    features, x = scale.features(inputs[:, own], valid[:, own])[good], inputs[good][:, rest]
    followed = _followed(features, x)
    if not followed.any():
        return None
    followers = tuple(names[i] for i, follows in zip(rest, followed, strict=True) if follows)
    # The other inputs, such as the hall's, show the effect of the weather; in a forecast they stay as they are.
    heat = heat_of(np.hstack([features, x[:, ~followed]]), x[:, followed])
    size = features.shape[1]
    return LoadResponse(followers, scale, heat.weights[:size])


def _followed(features: FloatArray, x: FloatArray) -> BoolArray:
    """(m,) whether the features predict rows (T, m) of the parts that were left out."""
    with_loads, without = np.zeros(x.shape[1]), np.zeros(x.shape[1])
    for part in np.array_split(np.arange(len(x)), _PARTS):
        others = np.ones(len(x), dtype=np.bool_)
        others[part] = False
        heat = heat_of(features[others], x[others])
        off = x[part] - heat.explained(features[part])  # its level is not asked for: only changes are
        with_loads += np.var(off, axis=0)
        without += np.var(x[part], axis=0)
    return np.asarray(with_loads <= _LEAST_FOLLOWED * without, dtype=np.bool_)
