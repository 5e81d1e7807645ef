"""Surrogate: a Gaussian process of all values so far, and points of greatest expected improvement.

It is for budgets that are too small for an evolution (Jones, Schonlau and Welch, 1998). Values are
replaced by the normal scores of their ranks, since robustness has jumps and long tails.
"""

from __future__ import annotations

import numpy as np

from pytest_dura.search.searchers import (
    BangBang,
    Floats,
    Points,
    Pushes,
    Searcher,
    Uniform,
    Values,
    filled,
)
from pytest_dura.search.space import Layout

_LENGTHS = (0.1, 0.2, 0.4, 0.8, 1.6)
"""Length scales that are tried, in the root mean square of a group's pieces."""
_NOISES = (1e-4, 1e-2, 1e-1)
"""Variances of what a point does not determine, such as its seed, as a part of the whole."""
_FRESH = 32
"""Points of each trivial searcher among the candidates."""
_NEAR = 24
"""Changes of each of the best points among the candidates."""
_BEST = 6
_MOST = 300
"""Values that the process rests on, the least ones: time grows with the cube of their number."""
_LEAST_KNOWN = 8
"""Values below which it proposes at random."""
_BATCH = 4
"""Points that it proposes at once."""


class Surrogate(Searcher):
    """Points that a Gaussian process expects to improve most, among simple and changed ones.

    It learns from the points of all searchers, see :meth:`observe`.
    """

    name = "surrogate"
    trivial = False

    def __init__(self, layout: Layout, rng: np.random.Generator) -> None:
        super().__init__(layout, rng)
        kinds = [kind for kind in (Uniform, BangBang, Pushes) if kind.suits(layout)]
        self._fresh = [kind(layout, rng) for kind in kinds]
        self._points: list[Points] = []
        self._values: list[Values] = []
        self.objective = 0
        """Number of the objective that the next points are to make small."""

    def observe(self, points: Points, values: Values) -> None:
        """Learn from points that any searcher proposed.

        Args:
            points: Shape ``(k, layout.size)``.
            values: Of all objectives, shape ``(k, objectives)``; NaN where nothing is known.
        """
        self._points.append(points)
        self._values.append(values)

    def ask(self) -> Points:
        """Return points one after the other, each as if those before came out as expected."""
        known = np.vstack(self._values)[:, self.objective] if self._values else np.empty(0)
        if np.isfinite(known).sum() < _LEAST_KNOWN:
            return self._fresh[0].ask()
        least = np.argsort(filled(known), kind="stable")[:_MOST]
        points, values = np.vstack(self._points)[least], _scores(filled(known)[least])
        coordinates = self._coordinates(points)
        model = _Process.fitted(coordinates, values)
        candidates = self._candidates(points, values)
        others = self._coordinates(candidates)
        chosen = []
        for _ in range(_BATCH):
            mean, spread = model.predict(others)
            index = int(np.argmax(_expected_improvement(mean, spread, values.min())))
            chosen.append(candidates[index])
            model = model.believing(others[index], mean[index])
        return np.array(chosen)

    def _coordinates(self, points: Points) -> Floats:
        """Scale each group so that its pieces together weigh as much as a single number."""
        parts = []
        for group, where in self.layout.slices():
            part = points[:, where]
            if group.options:  # another option is as far as the other end of a range
                option = np.minimum((part * group.options).astype(int), group.options - 1)
                parts.append(np.eye(group.options)[option[:, 0]] / np.sqrt(2.0))
            else:
                parts.append(part / np.sqrt(group.size))
        return np.hstack(parts)

    def _candidates(self, points: Points, values: Floats) -> Points:
        made = []
        for searcher in self._fresh:
            count = 0
            while count < _FRESH:
                made.append(searcher.ask())
                count += len(made[-1])
        for best in points[np.argsort(values, kind="stable")[:_BEST]]:
            near = np.repeat(best[None], _NEAR, axis=0)
            # Few coordinates by much, or many by little.
            share = self.rng.choice([0.1, 0.3, 1.0], size=(_NEAR, 1))
            sigma = self.rng.choice([0.03, 0.1, 0.3], size=(_NEAR, 1))
            moved = self.rng.random(near.shape) < share
            near += moved * sigma * self.rng.standard_normal(near.shape)
            made.append(np.clip(near, 0.0, 1.0))
        return np.vstack(made)


class _Process:
    """A Gaussian process of a Matern kernel (5/2) with mean 0 and variance 1."""

    def __init__(self, points: Floats, values: Floats, length: float, noise: float) -> None:
        self._points, self._values, self._length, self._noise = points, values, length, noise
        from scipy.linalg import cho_factor, cho_solve

        covariance = _kernel(points, points, length)
        covariance[np.diag_indices_from(covariance)] += noise
        self._factor = cho_factor(covariance, lower=True)
        self._weights = cho_solve(self._factor, values)

    @classmethod
    def fitted(cls, points: Floats, values: Floats) -> _Process:
        """Make the one of the greatest likelihood among the lengths and noises."""
        processes = [cls(points, values, each, noise) for each in _LENGTHS for noise in _NOISES]
        return max(processes, key=lambda process: process.likelihood)

    @property
    def likelihood(self) -> float:
        """Logarithm of the marginal likelihood, but for a constant."""
        half_determinant = np.log(np.diag(self._factor[0])).sum()
        return float(-0.5 * self._values @ self._weights - half_determinant)

    def predict(self, points: Floats) -> tuple[Floats, Floats]:
        """Return means and standard deviations."""
        from scipy.linalg import cho_solve

        across = _kernel(points, self._points, self._length)
        explained = np.sum(across * cho_solve(self._factor, across.T).T, axis=1)
        return across @ self._weights, np.sqrt(np.maximum(1.0 - explained, 1e-12))

    def believing(self, point: Floats, value: float) -> _Process:
        """Return the process that has seen this value as well."""
        points = np.vstack([self._points, point])
        return _Process(points, np.append(self._values, value), self._length, self._noise)


def _kernel(first: Floats, second: Floats, length: float) -> Floats:
    squares = np.sum(first**2, axis=1)[:, None] + np.sum(second**2, axis=1)
    scaled = np.sqrt(5.0 * np.maximum(squares - 2.0 * first @ second.T, 0.0)) / length
    covariance: Floats = (1.0 + scaled + scaled**2 / 3.0) * np.exp(-scaled)
    return covariance


def _scores(values: Floats) -> Floats:
    """Return the normal scores of the ranks; equal values have equal ones."""
    from scipy.special import ndtri

    ordered = np.sort(values)
    ranks = (np.searchsorted(ordered, values) + np.searchsorted(ordered, values, "right")) / 2.0
    scores: Floats = ndtri(np.clip(ranks / len(values), 0.5 / len(values), 1 - 0.5 / len(values)))
    return scores


def _expected_improvement(mean: Floats, spread: Floats, best: float) -> Floats:
    from scipy.special import ndtr

    z = (best - mean) / spread
    density = np.exp(-0.5 * z**2) / np.sqrt(2.0 * np.pi)
    improvement: Floats = spread * (z * ndtr(z) + density)
    return improvement
