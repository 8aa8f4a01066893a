"""Bilinear matrix inequalities, lifted and solved as a sequence of semidefinite programs.

The general form behind contact synthesis, for small problems (Basumatary et al., "Grasp Force
Optimization as a Bilinear Matrix Inequality Problem", equations 1 to 10): products x_i x_j become
entries X_ij of a matrix variable with

    M = [[X, x], [x', 1]] >= 0,  rank(M) = 1.

Without the rank this is a semidefinite program. The rank is reached by a sequence of them (after
Ibaraki and Tomizuka, "Rank minimization approach for solving BMI problems with random search",
2001, and Dai, Majumdar and Tedrake 2018), here without the random search.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import cvxpy as cp
import numpy as np
from numpy.typing import ArrayLike

from solvers.arrays import Array
from solvers.exceptions import ProblemError, SolverError

RANK_ONE = 1e-4
"""Second over first eigenvalue of M, with x scaled to [-1, 1], below which M is of rank one."""

RESIDUAL = 1e-6
"""Largest violation of a solved problem, over the largest entry of that inequality in the box."""

_TARGET_RATIO = 1e-8
_SETTLED = 1e-9
_MAX_STEPS = 100
_FIRST_PENALTY = 0.005
_PENALTY_GROWTH = 1.5
_SYMMETRY_BREAK = 0.01
_ROUNDING = 1e-12
_ACCURACY = {
    **dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), 1e-9),
    **dict.fromkeys(("tol_infeas_abs", "tol_infeas_rel"), 1e-9),
}


class BilinearStatus(StrEnum):
    """How a minimisation ended; the same words as for contact synthesis."""

    SOLVED = "solved"
    """M is of rank one, and every inequality holds at x as it was given, not as it was lifted."""
    INFEASIBLE = "infeasible"
    """No x in the box satisfies the inequalities: multipliers of the relaxation prove it."""
    FAILED = "failed"
    """Neither; the message says why."""


@dataclass(frozen=True, eq=False)
class BilinearMatrixInequality:
    """F(x) = F_0 + sum_i x_i F_i + sum_ij x_i x_j F_ij >= 0, positive semidefinite (equation 4).

    A linear matrix inequality is the case F_ij = 0. The paper writes that one as F(x) <= 0 and
    then calls F(x) positive definite (equations 1 and 2); the sign here is that of its equation 4.

    Args:
        constant: (m, m) F_0.
        linear: (N, m, m) F_i.
        bilinear: (N, N, m, m) F_ij, each symmetric; F_ij and F_ji may differ, their sum counts.

    Raises:
        ProblemError: for other shapes, values that are not finite, or matrices not symmetric.
    """

    constant: Array
    linear: Array
    bilinear: Array

    def __post_init__(self) -> None:
        shape = np.shape(self.linear)
        if len(shape) != 3 or 0 in shape:
            raise ProblemError(f"linear must have shape (N, m, m), none of them 0, not {shape}")
        count, size = shape[:2]
        shapes = {
            "constant": (size, size),
            "linear": (count, size, size),
            "bilinear": (count, count, size, size),
        }
        for name, expected in shapes.items():
            array = _finite(name, getattr(self, name), expected)
            transposed = array.swapaxes(-1, -2)
            if not np.allclose(array, transposed, rtol=0.0, atol=1e-9 * np.abs(array).max()):
                raise ProblemError(f"every matrix of {name} must be symmetric")
            object.__setattr__(self, name, 0.5 * (array + transposed))

    def __call__(self, x: ArrayLike) -> Array:
        """(..., m, m) F(x) at x (..., N)."""
        x = np.asarray(x, dtype=np.float64)
        return self.lifted(x, x[..., :, None] * x[..., None, :])

    def lifted(self, x: ArrayLike, X: ArrayLike) -> Array:
        """(..., m, m) F with X (..., N, N) in place of the products x x' (equation 6)."""
        affine = self.constant + np.tensordot(np.asarray(x), self.linear, axes=(-1, 0))
        products = np.tensordot(np.asarray(X), self.bilinear, axes=((-2, -1), (0, 1)))
        return np.asarray(affine + products)


@dataclass(frozen=True, eq=False)
class BilinearSolution:
    """What `minimise` found.

    Args:
        status: decided by the rank and the violation, not by the solver's words.
        x: (N,) within the box; NaN if the relaxation gave no point.
        M: (N + 1, N + 1) [[X, x], [x', 1]] as the last program left it.
        objective: c'x.
        bound: no x in the box that satisfies the inequalities has a lower c'x. It comes from the
            relaxation's multipliers by weak duality, so that it holds however accurate they are;
            inf if they prove that there is none, -inf if there are none.
        eigenvalue_ratio: second over first eigenvalue of M, with x scaled to [-1, 1].
        violation: how far the least eigenvalue of any F(x) lies below zero; 0 if none does.
        steps: semidefinite programs that were solved.
        message: why it failed; else "".
    """

    status: BilinearStatus
    x: Array
    M: Array
    objective: float
    bound: float
    eigenvalue_ratio: float
    violation: float
    steps: int
    message: str


def minimise(
    cost: ArrayLike,
    inequalities: Sequence[BilinearMatrixInequality],
    lower: ArrayLike,
    upper: ArrayLike,
) -> BilinearSolution:
    """A local minimum of c'x with every F(x) >= 0 and lower <= x <= upper.

    First the relaxation without the rank. Then a sequence of programs that minimise c'x plus a
    penalty times trace(M) - v'Mv, where v is the unit vector along (x, 1) of the point before, all
    with x scaled to [-1, 1]: it is zero only where M is a multiple of v v'. The penalty grows until
    M is of rank one, and then stays: it now acts as a proximal term, and steps go on for as long
    as they lower the cost.

    Such problems are NP-hard and this is a local method: it may end in a local minimum, close to
    another stationary point, or without a feasible point where there is one. `objective` less
    `bound` tells how far from the global optimum it can be at most; a gap may also come from the
    relaxation, which is not tight in general.

    Args:
        cost: (N,) c.
        inequalities: each with N variables; all must hold.
        lower: (N,) finite. The box bounds the relaxation by the products of its sides
            (McCormick's inequalities), and a narrower box gives a better bound.
        upper: (N,) finite, not below `lower`.

    Raises:
        ProblemError: for shapes that do not agree, values that are not finite, or an empty box.
    """
    cost = _finite("cost", cost, np.shape(cost))
    if cost.ndim != 1 or not len(cost):
        raise ProblemError(f"cost must have shape (N,), not {cost.shape}")
    lower, upper = (_finite(n, v, cost.shape) for n, v in (("lower", lower), ("upper", upper)))
    if (lower > upper).any():
        raise ProblemError(f"lower exceeds upper at index {int((lower > upper).argmax())}")
    for index, inequality in enumerate(inequalities):
        if len(inequality.linear) != len(cost):
            raise ProblemError(
                f"inequality {index} has {len(inequality.linear)} variables, cost {len(cost)}"
            )
    program = _LiftedProgram(cost, inequalities, lower, upper)
    try:
        M = program.solve(program.cost)
    except SolverError as error:
        # where nothing satisfies the inequalities, even a cost of 0 exceeds 0
        proven = program.lower_bound(np.zeros_like(program.cost)) > 0.0
        return _without_point(len(cost), proven, str(error))
    bound = program.scale * program.lower_bound(program.cost)
    steps, penalty, previous, message = 1, _FIRST_PENALTY, np.inf, ""
    point = _off_symmetry(M)
    while steps < _MAX_STEPS:
        weight = np.eye(len(point)) - np.outer(point, point) / (point @ point)
        try:
            # a mean of the two, so that the numbers stay moderate however large the penalty
            M = program.solve((program.cost + penalty * weight) / (1.0 + penalty))
        except SolverError as error:
            message = str(error)
            break
        steps += 1
        point, value = M[:, -1], float(np.vdot(program.cost, M))
        if _ratio(M) > _TARGET_RATIO:
            penalty, previous = _PENALTY_GROWTH * penalty, np.inf
        elif value > previous - _SETTLED:
            break
        else:
            previous = value
    ratio, x = _ratio(M), np.clip(program.box[:-1] @ M[:, -1], lower, upper)
    least = np.array([np.linalg.eigvalsh(inequality(x))[0] for inequality in inequalities])
    residual = float((-least / program.sizes).max(initial=0.0))
    solved = ratio <= RANK_ONE and residual <= RESIDUAL
    if not solved and not message:
        message = f"eigenvalue ratio {ratio:.1e} and residual {residual:.1e} after {steps} steps"
    return BilinearSolution(
        status=BilinearStatus.SOLVED if solved else BilinearStatus.FAILED,
        x=x,
        M=program.box @ M @ program.box.T,
        objective=float(cost @ x),
        bound=bound,
        eigenvalue_ratio=ratio,
        violation=float((-least).max(initial=0.0)),
        steps=steps,
        message="" if solved else message,
    )


class _LiftedProgram:
    """The lifted program in z = (x - centre) / half width, with (x, 1) = box (z, 1).

    Whatever is quadratic in z is sum_ab A_ab M_ab, with a matrix A (N + 1, N + 1) for the cost and
    for every entry of an inequality. The cost is divided by `scale`, its range in the box, and an
    inequality by its one of `sizes`, the most that an entry of it can be there.
    """

    def __init__(
        self,
        cost: Array,
        inequalities: Sequence[BilinearMatrixInequality],
        lower: Array,
        upper: Array,
    ) -> None:
        n = len(cost)
        self.box = np.diag(np.append(0.5 * (upper - lower), 1.0))
        self.box[:n, n] = 0.5 * (upper + lower)
        self.cost = np.zeros((n + 1, n + 1))
        self.cost[:n, n] = self.cost[n, :n] = 0.5 * cost
        self.scale = float(np.abs(cost) @ (upper - lower)) or 1.0
        self.cost = self.box.T @ self.cost @ self.box / self.scale

        self.sizes = np.ones(len(inequalities))
        # of 1 + z_i >= 0 and 1 - z_i >= 0, the products of any two
        sides = np.vstack([np.eye(n, n + 1), -np.eye(n, n + 1)])
        sides[:, n] = 1.0
        first, second = np.triu_indices(2 * n, 1)
        products = np.einsum("pa,pb->abp", sides[first], sides[second])
        self._forms = [0.5 * (products + products.swapaxes(0, 1))]
        for index, inequality in enumerate(inequalities):
            form = np.zeros((n + 1, n + 1, *inequality.constant.shape))
            form[:n, :n] = 0.5 * (inequality.bilinear + inequality.bilinear.swapaxes(0, 1))
            form[:n, n] = form[n, :n] = 0.5 * inequality.linear
            form[n, n] = inequality.constant
            form = np.einsum("ca,cdij,db->abij", self.box, form, self.box)
            self.sizes[index] = float(np.abs(form).sum(axis=(0, 1)).max()) or 1.0
            self._forms.append(form / self.sizes[index])

        self._lift: Any = cp.Variable((n + 1, n + 1), symmetric=True)
        self._weight = cp.Parameter((n + 1, n + 1))
        entries = self._lift.flatten(order="C")
        self._constraints = [self._lift >> 0, entries @ self._forms[0].reshape(-1, len(first)) >= 0]
        for form in self._forms[1:]:
            m = form.shape[-1]
            matrix = (entries @ form.reshape(-1, m * m)).reshape((m, m), order="C")
            self._constraints.append(matrix >> 0)
        goal = cp.Minimize((self._weight @ self._lift).trace())
        self._program = cp.Problem(goal, [*self._constraints, self._lift[n, n] == 1])

    def solve(self, weight: Array) -> Array:
        """(N + 1, N + 1) the M for which sum_ab weight_ab M_ab is least.

        Raises:
            SolverError: if there is none, in the solver's own words.
        """
        self._weight.value = weight
        try:
            with warnings.catch_warnings():
                # how accurate it is, rank and violation tell
                warnings.filterwarnings("ignore", "Solution may be inaccurate", UserWarning)
                self._program.solve(solver=cp.CLARABEL, **_ACCURACY)
        except cp.SolverError as error:
            raise SolverError(f"cvxpy: {error}") from error
        value = self._lift.value
        if value is None or not np.isfinite(value).all():
            raise SolverError(f"clarabel ended with {self._program.status}")
        return np.asarray(value / value[-1, -1])

    def lower_bound(self, cost: Array) -> float:
        """What (z, 1)' cost (z, 1) cannot be below where z is feasible; -inf without multipliers.

        Multipliers times constraints, taken from the cost, leave a quadratic form in (z, 1). With
        exact multipliers it is constant; of what is left besides, |z_i| <= 1 bounds the size.
        """
        duals = [constraint.dual_value for constraint in self._constraints]
        if any(dual is None or not np.isfinite(dual).all() for dual in duals):
            return -np.inf
        positive = _semidefinite(duals[0])
        multipliers = [np.maximum(duals[1], 0.0)]
        for form, dual in zip(self._forms[1:], duals[2:], strict=True):
            multipliers.append(_semidefinite(np.reshape(dual, form.shape[2:])))
        rest = cost - positive
        for form, multiplier in zip(self._forms, multipliers, strict=True):
            rest = rest - np.tensordot(form, multiplier, axes=multiplier.ndim)
        rounding = _ROUNDING * sum(float(np.abs(part).sum()) for part in (positive, *multipliers))
        constant = float(rest[-1, -1])
        return constant - (float(np.abs(rest).sum()) - abs(constant)) - rounding


def _off_symmetry(M: Array) -> Array:
    """(N + 1,) (z, 1) of M, moved a little to where X exceeds z z' most.

    In a problem symmetric in z and -z the relaxation has z = 0, and v would hold all else to it.
    """
    z = M[:-1, -1]
    values, vectors = np.linalg.eigh(M[:-1, :-1] - np.outer(z, z))
    excess = np.sqrt(max(values[-1], 0.0)) * vectors[:, -1]
    # eigenvectors have no sign of their own
    excess *= np.sign(excess[np.abs(excess).argmax()])
    return np.append(z + _SYMMETRY_BREAK * excess, 1.0)


def _ratio(M: Array) -> float:
    values = np.linalg.eigvalsh(M)
    return float(max(values[-2], 0.0) / values[-1])


def _semidefinite(matrix: Array) -> Array:
    """(m, m) the nearest positive semidefinite matrix."""
    values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)


def _without_point(count: int, proven: bool, message: str) -> BilinearSolution:
    return BilinearSolution(
        status=BilinearStatus.INFEASIBLE if proven else BilinearStatus.FAILED,
        x=np.full(count, np.nan),
        M=np.full((count + 1, count + 1), np.nan),
        objective=np.nan,
        bound=np.inf if proven else -np.inf,
        eigenvalue_ratio=np.nan,
        violation=np.nan,
        steps=1,
        message="" if proven else message,
    )


def _finite(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    array = np.asarray(value, dtype=np.float64)
    if array.shape != shape:
        raise ProblemError(f"{name} must have shape {shape}, not {array.shape}")
    if not np.isfinite(array).all():
        raise ProblemError(f"{name} must be finite")
    return array
