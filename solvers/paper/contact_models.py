"""The three contact models of the grasping literature, each as a cone and as a matrix inequality.

L. Han, J. C. Trinkle and Z. X. Li, "Grasp analysis as linear matrix inequality problems", IEEE
Transactions on Robotics and Automation 16(6), 2000: frictionless point contact (FPC), point contact
with friction (PCWF) and the elliptic soft finger (SFCE). Each cone has the form of equation 25 of
Basumatary et al., f_n >= 0 and |x_t|_w <= f_n, with a weighted norm of its own, and is the set
where a matrix P(x) = sum_j x_j S_j is positive semidefinite (equations 29 to 33).
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from numbers import Real
from typing import Any, ClassVar

import numpy as np

from solvers.exceptions import ProblemError


@dataclass(frozen=True)
class ContactModel(ABC):
    """A cone of contact wrenches x in the contact's frame; the components say the subclasses.

    Raises:
        ProblemError: for a coefficient of friction that is negative, not finite or no number.
    """

    size: ClassVar[int]
    """Components of x."""

    normal: ClassVar[int]
    """Index of the normal force f_n in x."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not isinstance(value, Real) or isinstance(value, bool | np.bool_):
                raise ProblemError(
                    f"{field.name} must be a number, not {type(value).__name__}: one contact has "
                    "one coefficient of each kind"
                )
            # written so that NaN is refused too
            if not 0.0 <= float(value) < np.inf:
                raise ProblemError(f"{field.name} must be finite and not negative, not {value}")

    @abstractmethod
    def weighted_norm(self, wrench: Any) -> np.ndarray:
        """(...,) N: |x_t|_w of wrenches (..., size), the least normal force that x_t needs.

        Infinite where no normal force is enough: a load on a component without any friction.
        """

    @abstractmethod
    def coefficients(self) -> np.ndarray:
        """(size, k, k) symmetric S_j; P(x) = sum_j x_j S_j is what `matrix` evaluates."""

    def violation(self, wrench: Any) -> np.ndarray:
        """(...,) N: the normal force that is missing, max(0, |x_t|_w - f_n); 0 inside the cone.

        A contact that pulls misses at least its pull. Where mu > 0, mu times this is the tangential
        excess that `residuals.friction_violation` measures.
        """
        wrench = self._checked(wrench)
        return np.maximum(self.weighted_norm(wrench) - wrench[..., self.normal], 0.0)

    def matrix(self, wrench: Any) -> np.ndarray:
        """(..., k, k) P(x), positive semidefinite exactly inside the cone; see the subclasses."""
        return np.tensordot(self._checked(wrench), self.coefficients(), axes=(-1, 0))

    def _checked(self, wrench: Any) -> np.ndarray:
        array = np.asarray(wrench, dtype=np.float64)
        if array.ndim == 0 or array.shape[-1] != self.size:
            raise ProblemError(
                f"a wrench of a {type(self).__name__} has {self.size} component(s) in its last "
                f"dimension; this one has the shape {array.shape}"
            )
        return array


@dataclass(frozen=True)
class FrictionlessContact(ContactModel):
    """FPC, x = (f_n): a contact that can only push. P = [f_n]."""

    size: ClassVar[int] = 1
    normal: ClassVar[int] = 0

    def weighted_norm(self, wrench: Any) -> np.ndarray:
        """(...,) zeros: nothing has to be held by friction."""
        return np.zeros(self._checked(wrench).shape[:-1])

    def coefficients(self) -> np.ndarray:
        """(1, 1, 1) one."""
        return np.ones((1, 1, 1))


@dataclass(frozen=True)
class FrictionContact(ContactModel):
    """PCWF, x = (f_t1, f_t2, f_n) in N with |f_t| <= mu f_n: Coulomb friction.

    P = [[mu f_n, 0, f_t1], [0, mu f_n, f_t2], [f_t1, f_t2, mu f_n]] as printed (equation 30), with
    eigenvalues mu f_n and mu f_n +- |f_t|. Without friction it demands f_t = 0 and says nothing
    about f_n: f_n >= 0 must then be a row of its own.

    Args:
        friction: mu >= 0.
    """

    size: ClassVar[int] = 3
    normal: ClassVar[int] = 2

    friction: float

    def weighted_norm(self, wrench: Any) -> np.ndarray:
        """(...,) N: |f_t| / mu (equation 26)."""
        force = self._checked(wrench)
        return _over(np.hypot(force[..., 0], force[..., 1]), self.friction)

    def coefficients(self) -> np.ndarray:
        """(3, 3, 3) S_1, S_2, S_3 of equation 30."""
        matrices = _arrow(3, 3)
        matrices[2] = self.friction * np.eye(3)
        return matrices


@dataclass(frozen=True)
class SoftFingerContact(ContactModel):
    """SFCE, x = (f_t1, f_t2, f_n, m_n): friction that also holds a moment about the normal.

    sqrt(|f_t|^2 / mu^2 + m_n^2 / mu_s^2) <= f_n. Forces in N, the moment in N·m.

    P = [[mu^2 f_n, 0, 0, f_t1], [0, mu^2 f_n, 0, f_t2], [0, 0, mu_s^2 f_n, m_n],
    [f_t1, f_t2, m_n, f_n]]: the matrix of Han et al. with its first three rows and columns times
    mu, mu and mu_s, so that nothing is divided by a coefficient that may be zero. Its Schur
    complement is f_n - (|f_t|^2 / mu^2 + m_n^2 / mu_s^2) / f_n. It is exact at zero too: a diagonal
    entry of zero forces its row to zero, so that without friction f_t = 0, without torsional
    friction m_n = 0, and the last entry says f_n >= 0 in every case. The units of the entries
    differ, so that only the signs of the eigenvalues mean anything; those of a load on a kind of
    friction that is zero are of second order, -m_n^2 / f_n.

    Args:
        friction: mu >= 0.
        torsional_friction: mu_s >= 0, m: the moment that the contact holds per normal force.
    """

    size: ClassVar[int] = 4
    normal: ClassVar[int] = 2

    friction: float
    torsional_friction: float

    def weighted_norm(self, wrench: Any) -> np.ndarray:
        """(...,) N: sqrt(|f_t|^2 / mu^2 + m_n^2 / mu_s^2)."""
        wrench = self._checked(wrench)
        sliding = _over(np.hypot(wrench[..., 0], wrench[..., 1]), self.friction)
        turning = _over(np.abs(wrench[..., 3]), self.torsional_friction)
        return np.hypot(sliding, turning)

    def coefficients(self) -> np.ndarray:
        """(4, 4, 4) S_1 to S_4, in the order of x."""
        first, second, turning = _arrow(4, 4)[:3]
        square, torsional_square = self.friction**2, self.torsional_friction**2
        normal = np.diag([square, square, torsional_square, 1.0])
        return np.stack([first, second, normal, turning])


def _arrow(count: int, size: int) -> np.ndarray:
    """(count, size, size) matrices whose j-th puts x_j at the end of row j, and of column j."""
    matrices = np.zeros((count, size, size))
    for index in range(size - 1):
        matrices[index, index, -1] = matrices[index, -1, index] = 1.0
    return matrices


def _over(load: np.ndarray, coefficient: float) -> np.ndarray:
    """load / coefficient, where 0 / 0 is 0: no load needs no friction."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        return np.where(load == 0.0, 0.0, load / np.float64(coefficient))
