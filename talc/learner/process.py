"""Gaussian processes of all thermal errors, which share the rows that were measured."""

import math
from dataclasses import dataclass

import numpy as np

from talc import _kernel
from talc.frame import FloatArray
from talc.learner.experts import UNIT, Expert

MOST_ROWS = 300
"""Rows that are kept. When there are as many, neighbours are merged until _FEWER are left."""
_FEWER = 200
OTHER_REFERENCE = 1e5
"""µm² or (µm/m)²: variance of the level from one reference to the next, so large that neither tells of the other's.
Rows on either side of as large a change are not merged."""
NEWEST = 40
"""Rows that are never merged."""
_PRIOR_COUNTS = 0.5
"""Weights that the prior variance before counts for when it is renewed."""
_CHANGE = 0.1, 3.0
"""Bounds of one renewal."""
_RELEVANCE = 1e-4, 1e2
"""Bounds of a prior variance over its first one."""
_NODES, _NODE_WEIGHTS = np.polynomial.legendre.leggauss(8)
"""On [-1, 1]: a piece, at most `_PIECE` long, of the path from the reference to the present features."""
_PIECE = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class OtherMachines:
    """What other machines have learnt, in the order of this machine's inputs."""

    machines: FloatArray
    """(9,) number of machines that know each error."""
    mean: FloatArray
    """(9, p) weights of the features."""
    covariance: FloatArray
    """(9, p, p); variance 0: an input that they do not have."""


def _square(x: FloatArray) -> FloatArray:
    """(...,) of features (..., p); the same bits for one row and for many."""
    return np.asarray(np.sum(x * x, axis=-1))


class Rows:
    """Measurements in the order of their times, with the features that they were made at.

    Parameters
    ----------
    features: p
    errors: m
    """

    def __init__(self, features: int, errors: int) -> None:
        self.n = 0
        self.x = np.zeros((MOST_ROWS, features))
        self.square, self.time, self.weight = np.zeros((3, MOST_ROWS))
        self.jolt, self.y = np.zeros((2, MOST_ROWS, errors))
        self.noise = np.full((MOST_ROWS, errors), np.inf)
        self.reference = np.zeros(errors)
        """(m,) variance of the reference's noise, part of every measurement; 0: `jolt` has it, as there are several."""
        self.known = np.zeros((errors, MOST_ROWS))
        """(m, rows) 1 where an error was measured."""

    def is_full(self) -> bool:
        """Whether there is no place for another one."""
        return self.n == MOST_ROWS

    def put(self, *values: FloatArray) -> None:
        """All rows: x, time, weight, jolt, y, noise, each (n, ...)."""
        self.n = len(values[0])
        own = self.x, self.time, self.weight, self.jolt, self.y, self.noise
        for to, value in zip(own, values, strict=True):
            to[: self.n] = value
        self.square[: self.n] = _square(self.x[: self.n])
        self.known[:, : self.n] = np.isfinite(self.noise[: self.n]).T

    def append(self, x: FloatArray, time: float, jolt: FloatArray, y: FloatArray, noise: FloatArray) -> None:
        """One more row."""
        n, self.n = self.n, self.n + 1
        self.x[n], self.square[n], self.time[n], self.weight[n] = x, _square(x), time, 1.0
        self.jolt[n], self.y[n], self.noise[n] = jolt, y, noise
        self.known[:, n] = np.isfinite(noise)

    def forget(self, j: int, first: int, jolt: float) -> None:
        """One error was not measured from a row on, and its level did not move since then."""
        self.noise[first : self.n, j], self.known[j, first : self.n] = np.inf, 0.0
        self.y[first : self.n, j], self.jolt[first : self.n, j] = 0.0, jolt

    def rescale(self, factor: FloatArray) -> None:
        """Features become (p,) factor times themselves."""
        self.x[: self.n] *= factor
        self.square[: self.n] = _square(self.x[: self.n])

    def thin(self) -> None:
        """Merge the neighbours that are closest in time, as often as it takes; a row then stands for several.

        A dense beginning so keeps its place, with fewer rows of less noise.
        """
        x, time, weight = list(self.x[: self.n]), self.time[: self.n].tolist(), self.weight[: self.n].tolist()
        jolt, y, noise = list(self.jolt[: self.n]), list(self.y[: self.n]), list(self.noise[: self.n])
        while len(x) > _FEWER:
            apart = np.diff(time[: len(time) - NEWEST])
            apart[np.diff([float(each.max()) for each in jolt[: len(time) - NEWEST]]) > OTHER_REFERENCE / 2.0] = np.inf
            i = int(np.argmin(apart))
            a, b = weight[i], weight[i + 1]
            told = a / noise[i], b / noise[i + 1]  # an error that only one measured keeps that one's value and noise
            both = np.maximum(told[0] + told[1], 1e-300)
            y[i] = (told[0] * y[i] + told[1] * y[i + 1]) / both
            noise[i] = np.where(told[0] + told[1] > 0.0, (a + b) / both, np.inf)
            x[i], time[i] = (a * x[i] + b * x[i + 1]) / (a + b), (a * time[i] + b * time[i + 1]) / (a + b)
            jolt[i], weight[i] = (a * jolt[i] + b * jolt[i + 1]) / (a + b), a + b
            for values in (x, time, weight, jolt, y, noise):
                del values[i + 1]
        self.put(*(np.array(v) for v in (x, time, weight, jolt, y, noise)))


class Process:
    """One expert: y = phi' w + f(phi) + b + c + e, each a priori normal and independent, given the features phi.

    The covariance of two measurements is that of phi' w, of the smooth f (squared exponential, conditioned on 0 at the
    reference), of the level b (a random walk) and of the reference's noise c. See Rasmussen and Williams, Gaussian
    Processes for Machine Learning (2006), chapters 2 and 4.

    Parameters
    ----------
    expert: its sizes
    rows: the measurements, shared with the other experts
    inputs: features are inputs times lags, input by input
    others: what other machines have learnt, for an expert that starts with it
    """

    def __init__(self, expert: Expert, rows: Rows, inputs: int, others: OtherMachines | None = None) -> None:
        self._expert, self._rows = expert, rows
        p, m = rows.x.shape[1], len(rows.reference)
        self._lags = p // max(inputs, 1)
        self._first = (expert.linear * UNIT) ** 2 / max(p, 1)
        self._level = (expert.level * UNIT) ** 2
        self._smooth, self._inverse = (expert.smooth * UNIT) ** 2, 0.5 / max(p, 1)
        self._misfit = (expert.misfit * UNIT) ** 2
        self.relevance = np.ones((m, inputs))
        """(m, inputs) prior variance of an input's weights over the first one; renewed by `renew`."""
        self._variance = np.full((m, p), self._first)
        """(m, p) of the weights a priori, by `relevance`."""
        self._mean = np.zeros((m, p))
        """(m, p) weights a priori."""
        self._covariance: FloatArray | None = None
        """(m, p, p) of the weights a priori, instead of `_variance`."""
        if expert.others and others is not None:
            self._start_from(others)
        self._lower = np.zeros((m, MOST_ROWS * (MOST_ROWS + 1) // 2))
        self._z, self._v = np.zeros((2, m, MOST_ROWS))
        self._centre, self._spread, self._alone = np.zeros((3, m))
        self._shares: FloatArray | None = None

    def _start_from(self, others: OtherMachines) -> None:
        """Weights as other machines have learnt them; of inputs that they do not have, as without knowledge."""
        known = others.machines > 0
        self._mean = np.where(known[:, None], others.mean, 0.0)
        covariance = self._expert.linear**2 * others.covariance * known[:, None, None]
        variance = np.einsum("jpp->jp", covariance)
        variance += np.where(variance > 0.0, 0.0, UNIT**2 / max(variance.shape[1], 1))
        self._covariance = covariance

    def _times_prior(self, x: FloatArray) -> FloatArray:
        """(m, p) features (p,) times the prior covariance of each error's weights; (1, p) where all have the same."""
        if self._covariance is not None:
            return np.stack([own @ x for own in self._covariance])
        return np.asarray((self._variance if self._expert.evidence else self._variance[:1]) * x)

    def _own(self, c: FloatArray, x: FloatArray, square: float) -> FloatArray:
        """Prior variances of phi' w + f."""
        return np.asarray(np.sum(c * x, axis=-1) + self._smooth * (1.0 - math.exp(-2.0 * self._inverse * square)))

    def _levels(self) -> FloatArray:
        """(m, rows) what the level adds to the covariance of a row with a later one."""
        return np.asarray(self._level * self._rows.time + self._rows.jolt.T)

    def look(
        self, x: FloatArray, now: float, jolted: FloatArray, *, reference: bool, rows_used: int | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """(m,) means and variances with features x (p,) at a time; of the errors, or with the reference's noise.

        rows_used: as if there were only so many rows, the oldest; None: all
        """
        rows, c, square = self._rows, self._times_prior(x), float(_square(x))
        levels = self._levels() + rows.reference[:, None] if reference else self._levels()
        given = c, x, square, self._smooth, self._inverse, levels, rows.known, self._lower, self._z
        n = rows.n if rows_used is None else rows_used
        _kernel.process_look(rows.x, rows.square, n, *given, self._v, self._centre, self._spread)
        self._alone = self._own(c, x, square)
        level = self._level * now + jolted + (rows.reference if reference else 0.0)
        return self._centre + self._mean @ x, self._alone + level - self._spread

    def together(
        self, x: FloatArray, others: FloatArray, now: float, later: FloatArray, jolted: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Of a measurement now with features x (p,), and the errors at S later times with others (S, p): (m,) mean of
        the one, (m, S) means of the others, and (m, S) their covariances."""
        n, c, square = self._rows.n, self._times_prior(x), float(_square(x))
        here, _ = self.look(x, now, jolted, reference=True)
        seen, there, shared = self._v[:, :n].copy(), [], []
        for other, at in zip(others, later.tolist(), strict=True):
            there.append(self.look(other, at, jolted, reference=False)[0])
            both = float(_square(other))
            apart = max(square + both - 2.0 * float(x @ other), 0.0)
            smooth = math.exp(-self._inverse * apart) - math.exp(-self._inverse * (square + both))
            prior = c @ other + self._smooth * smooth + self._level * now + jolted
            shared.append(prior - np.sum(seen * self._v[:, :n], axis=1))
        return here, np.array(there).T, np.array(shared).T

    def append(self, x: FloatArray, now: float, jolted: FloatArray, y: FloatArray, noise: FloatArray) -> None:
        """The row that `rows` takes next, at which `look` has just looked with the reference's noise: its measurements
        (m,), and their variances, infinite where there is none."""
        own = self._alone + (self._level * now + jolted + self._rows.reference) + (noise + self._misfit)
        off = y - self._mean @ x
        _kernel.process_append(self._lower, self._z, self._rows.n, self._v, self._centre, self._spread, own, off)
        self._shares = None

    def rebuild(self, only: int | None = None) -> None:
        """All errors' factors, or one's, from the rows."""
        rows, n = self._rows, self._rows.n
        x, own, y = rows.x[:n], np.full(MOST_ROWS, np.inf), np.zeros(MOST_ROWS)
        levels = self._levels() + rows.reference[:, None]
        for j in range(len(rows.reference)) if only is None else (only,):
            c = self._variance[j] * x
            if self._covariance is not None:
                c = np.array([self._covariance[j] @ row for row in x]).reshape(x.shape)
            alone = [float(self._own(c[i], x[i], float(rows.square[i]))) for i in range(n)]
            apart = self._level * rows.time[:n] + rows.jolt[:n, j] + rows.reference[j]
            own[:n] = np.array(alone) + apart + (rows.noise[:n, j] + self._misfit) / rows.weight[:n]
            y[:n] = rows.y[:n, j] - x @ self._mean[j]
            given = self._smooth, self._inverse, levels[j], rows.known[j], own, y
            _kernel.process_rebuild(rows.x, rows.square, n, c, *given, self._lower[j], self._z[j])
        self._shares = None

    def restore(self, relevance: FloatArray) -> None:
        """Continue with the (m, inputs) relevance and the rows of a state."""
        self.relevance = relevance.copy()
        for j in range(len(relevance)):
            self._believe(j)

    def _believe(self, j: int) -> None:
        """Follow one error's relevance."""
        self._variance[j] = self._first * np.repeat(self.relevance[j], self._lags)
        self.rebuild(j)

    def renew(self, j: int) -> None:
        """Find the prior variance of each input's weights again, by MacKay's fixed point (Neural Computation 4 (1992)
        415-447), v = sum(m²) / sum(1 - P / v) over the input's weights."""
        if not self._expert.evidence or not self.relevance.size:
            return
        n, prior = self._rows.n, self._variance[j]
        white = self._white(j)
        mean, learnt = prior * (white.T @ self._z[j, :n]), prior * np.sum(white**2, axis=0)
        before = self._first * self.relevance[j]
        square, count = (each.reshape(-1, self._lags).sum(axis=1) for each in (mean**2, learnt))
        found = (square + _PRIOR_COUNTS * before) / (np.maximum(count, 1e-3) + _PRIOR_COUNTS)
        least = np.maximum(_RELEVANCE[0] * self._first, _CHANGE[0] * before)
        most = np.minimum(_RELEVANCE[1] * self._first, _CHANGE[1] * before)
        self.relevance[j] = np.clip(found, least, most) / self._first
        self._believe(j)

    # What was learnt -------------------------------------------------------------------------------------------------

    def _rows_shares(self) -> FloatArray:
        """(m, n) of each row in the mean, K^-1 y."""
        if self._shares is None:
            n = self._rows.n
            self._shares = np.zeros((len(self._z), n))
            for j, shares in enumerate(self._shares):
                _kernel.process_shares(self._lower[j], self._z[j], n, shares)
        return self._shares

    def _white(self, j: int) -> FloatArray:
        n = self._rows.n
        white = np.empty((n, self._rows.x.shape[1]))
        _kernel.process_whiten(self._rows.x, n, self._rows.known[j], self._lower[j], white)
        return white

    def weights(self) -> FloatArray:
        """(m, p) means of the linear weights."""
        learnt = self._rows_shares() @ self._rows.x[: self._rows.n]
        if self._covariance is not None:
            return np.asarray(self._mean + np.einsum("jpq,jq->jp", self._covariance, learnt))
        return np.asarray(self._mean + self._variance * learnt)

    def weight_covariance(self, j: int) -> FloatArray:
        """(p, p) of one error's linear weights."""
        prior = np.diag(self._variance[j]) if self._covariance is None else self._covariance[j]
        told = self._white(j) @ prior
        return np.asarray(prior - told.T @ told)

    def level(self, now: float, jolted: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(m,) mean and variance of the level at a time."""
        rows, nothing = self._rows, np.zeros(self._rows.x.shape[1])
        given = nothing[None], nothing, 0.0, 0.0, 0.0, self._levels(), rows.known, self._lower, self._z
        _kernel.process_look(rows.x, rows.square, rows.n, *given, self._v, self._centre, self._spread)
        return self._centre.copy(), self._level * now + jolted - self._spread

    def contributions(self, x: FloatArray) -> FloatArray:
        """(m, p) what each feature adds to the mean of phi' w + f at x (p,); they add up to it.

        Each is the integral of the mean's slope in this feature along the straight path from the reference (Aumann and
        Shapley, Values of Non-Atomic Games, 1974); of a linear mean, weight times feature.
        """
        found = self.weights() * x
        if not self._smooth:
            return found
        rows, n, shares = self._rows, self._rows.n, self._rows_shares()
        far = np.exp(-self._inverse * rows.square[:n])
        pieces = 1 + int(math.sqrt(2.0 * self._inverse * float(x @ x)) / _PIECE)
        nodes = (np.arange(pieces)[:, None] + 0.5 * (_NODES + 1.0)).ravel() / pieces
        for node, weight in zip(nodes, np.tile(0.5 * _NODE_WEIGHTS / pieces, pieces), strict=True):
            at = node * x
            near = np.exp(-self._inverse * np.sum((at - rows.x[:n]) ** 2, axis=1))
            here = np.exp(-self._inverse * (at @ at))
            slope = (shares * near) @ rows.x[:n] + np.outer(shares @ (here * far - near), at)
            found = found + weight * 2.0 * self._inverse * self._smooth * slope * x
        return found
