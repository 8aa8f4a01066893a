"""A logistic regression on the measures, judged on objects that it was not fitted to."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit

from solvers.arrays import Array

FOLDS = 5
RIDGE = 1e-2


@dataclass(frozen=True, eq=False)
class Logistic:
    """The chance of holding, expit(weights @ z + bias), z standardised arsinh(x / scale).

    The inverse hyperbolic sine tames the long tails of forces, as a logarithm would, and takes
    zeros and negative values, too.

    Args:
        scale, mean, deviation: (p,) of the measures that it was fitted to.
        weights: (p,) per standard deviation.
        bias: of grasps that are average in all.
    """

    scale: Array
    mean: Array
    deviation: Array
    weights: Array
    bias: float

    @classmethod
    def fit(cls, values: Array, held: NDArray[np.bool_], ridge: float = RIDGE) -> "Logistic":
        """Minimise the mean log loss plus half of `ridge` times the weights' square.

        Args:
            values: (m, p) measures.
            held: (m,) outcomes.
            ridge: of the weights.
        """
        typical = np.median(np.abs(values), axis=0)
        scale = np.where(typical > 0.0, typical, 1.0)
        tamed = np.arcsinh(values / scale)
        mean, spread = tamed.mean(axis=0), tamed.std(axis=0)
        deviation = np.where(spread > 1e-12, spread, 1.0)
        z = (tamed - mean) / deviation
        sign = np.where(held, 1.0, -1.0)

        def loss(point: Array) -> tuple[float, Array]:
            weights, bias = point[:-1], point[-1]
            margin = sign * (z @ weights + bias)
            pull = -sign * expit(-margin) / len(sign)
            value = np.logaddexp(0.0, -margin).mean() + 0.5 * ridge * weights @ weights
            return float(value), np.append(z.T @ pull + ridge * weights, pull.sum())

        best = minimize(loss, np.zeros(values.shape[1] + 1), jac=True, method="L-BFGS-B").x
        return cls(scale, mean, deviation, best[:-1], float(best[-1]))

    def score(self, values: Array) -> Array:
        """(m,) log odds of holding, for measures (m, p)."""
        z = (np.arcsinh(values / self.scale) - self.mean) / self.deviation
        return np.asarray(z @ self.weights + self.bias)


def object_folds(
    object_ids: NDArray[np.str_], folds: int = FOLDS, seed: int = 0
) -> NDArray[np.int64]:
    """(m,) fold of each row; rows of one object share it, and folds have like many objects."""
    names, member = np.unique(object_ids, return_inverse=True)
    order = np.random.default_rng(seed).permutation(len(names))
    return np.asarray((order % folds)[member], dtype=np.int64)


def held_out_scores(
    values: Array, held: NDArray[np.bool_], object_ids: NDArray[np.str_], folds: int = FOLDS
) -> Array:
    """(m,) log odds of each row by the regression on the objects of all other folds.

    Args:
        values: (m, p) measures.
        held: (m,) outcomes.
        object_ids: (m,) of each row.
        folds: of objects.
    """
    fold = object_folds(object_ids, folds)
    scores = np.zeros(len(held))
    for k in np.unique(fold):
        mine = fold == k
        scores[mine] = Logistic.fit(values[~mine], held[~mine]).score(values[mine])
    return scores
