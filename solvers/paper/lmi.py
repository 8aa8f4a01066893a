"""The paper's form: friction cones and torque limits as one linear matrix inequality.

D(x) = D_0 + sum_l x_l D_l = blockdiag(P(x), T(x), N(x)) >= 0 holds exactly where the cone
constraints hold (Basumatary et al., equations 29 to 38). P is the blocks of the contact models,
T = blockdiag(T_L, T_U) the lower and the upper torque limits. The matrices S_l, which the paper
leaves undefined (equation 33), are the D_l restricted to P. N is added here: for each contact its
preload, and its cap where it has one.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np

from solvers.base import InstanceSolver
from solvers.exceptions import MissingDependencyError, ProblemError, SolverError
from solvers.problem import GraspForceProblem, Multipliers, force_scale, moment_arm
from solvers.solution import Candidate

from .contact_models import ContactModel, FrictionContact

BACKENDS: dict[str, dict[str, float]] = {
    "clarabel": {
        **dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), 1e-10),
        **dict.fromkeys(("tol_infeas_abs", "tol_infeas_rel"), 1e-10),
    },
    "scs": {"eps_abs": 1e-12, "eps_rel": 1e-12, "eps_infeas": 1e-10, "max_iters": 20_000},
}
"""The solvers of the semidefinite program, an interior-point and a first-order method, and the
accuracy asked of each."""


@dataclass(frozen=True, eq=False)
class LinearMatrixInequality:
    """D(x) = constant + sum_l x_l coefficients[l] >= 0, block diagonal, symmetric.

    Args:
        constant: (m, m) D_0.
        coefficients: (size, m, m) D_l; x is the components of all contacts, one after the other.
        contact_blocks: sizes of the blocks P_i, which lead; all that follows is 1 by 1.
        torque_size: size of T, which follows on P; the rest is N.
    """

    constant: np.ndarray
    coefficients: np.ndarray
    contact_blocks: tuple[int, ...]
    torque_size: int

    def __call__(self, wrenches: np.ndarray) -> np.ndarray:
        """(..., m, m) D(x) at contact wrenches (..., size)."""
        return self.constant + np.tensordot(wrenches, self.coefficients, axes=(-1, 0))

    @property
    def friction_size(self) -> int:
        """Size of P."""
        return sum(self.contact_blocks)

    @property
    def friction_coefficients(self) -> np.ndarray:
        """(size, friction_size, friction_size) S_l of P(x) = sum_l x_l S_l (equation 33)."""
        return self.coefficients[:, : self.friction_size, : self.friction_size]

    @property
    def torque_constant(self) -> np.ndarray:
        """(torque_size, torque_size) T_0 of T(x) = T_0 + sum_l x_l T_l (equation 37)."""
        rows = self._torque_rows
        return self.constant[rows, rows]

    @property
    def torque_coefficients(self) -> np.ndarray:
        """(size, torque_size, torque_size) T_l."""
        rows = self._torque_rows
        return self.coefficients[:, rows, rows]

    @property
    def _torque_rows(self) -> slice:
        return slice(self.friction_size, self.friction_size + self.torque_size)


def contact_inequality(
    contacts: Sequence[ContactModel],
    hand_jacobian: Any,
    torque_min: Any,
    torque_max: Any,
    external_torque: Any = None,
    normal_min: Any = None,
    normal_max: Any = None,
) -> LinearMatrixInequality:
    """D_0 and D_l for any mixture of contact models; infinite limits have no row.

    Every contact has a row f_n - normal_min >= 0, also where the preload is zero: the block of a
    `FrictionContact` without friction says nothing about f_n.

    Args:
        contacts: the model of each of n contacts; size is the sum of their components.
        hand_jacobian: (size, n_tau) J_h; joint torques are J_h' x + tau_ext; m, and 1 in the rows
            of moments.
        torque_min: (n_tau,) N·m; -inf where there is no limit.
        torque_max: (n_tau,) N·m; inf where there is no limit.
        external_torque: (n_tau,) N·m. Default 0.
        normal_min: (n,) preload >= 0, N. Default 0.
        normal_max: (n,) cap, N. Default inf.

    Raises:
        ProblemError: for what is no contact model, a wrong shape, a value that is no number or
            infinite where it must not be, crossed limits or a negative preload.
    """
    contacts = tuple(contacts)
    if not contacts or not all(isinstance(contact, ContactModel) for contact in contacts):
        raise ProblemError(
            "contacts must hold at least one contact, each a FrictionlessContact, a "
            "FrictionContact or a SoftFingerContact"
        )
    count, size = len(contacts), sum(contact.size for contact in contacts)
    n_tau = np.shape(torque_min)[-1] if np.ndim(torque_min) else 0
    jacobian = _array("hand_jacobian", hand_jacobian, (size, n_tau))
    lower = _array("torque_min", torque_min, (n_tau,), infinite=-np.inf)
    upper = _array("torque_max", torque_max, (n_tau,), infinite=np.inf)
    offset = _array("external_torque", external_torque, (n_tau,), default=0.0)
    preload = _array("normal_min", normal_min, (count,), default=0.0)
    cap = _array("normal_max", normal_max, (count,), default=np.inf, infinite=np.inf)
    if np.any(preload < 0.0):
        raise ProblemError("normal_min is negative; contacts push and never pull")
    if np.any(lower > upper) or np.any(preload > cap):
        raise ProblemError("a lower limit exceeds its upper limit; swap or widen the limits")

    # T and N are diagonal: row k of `rows` and of `offsets` is diagonal entry k
    below, above = np.isfinite(lower), np.isfinite(upper)
    rows = [*jacobian.T[below], *-jacobian.T[above]]
    offsets = [*(offset - lower)[below], *(upper - offset)[above]]
    torque_size = len(rows)
    starts = np.cumsum([0, *(contact.size for contact in contacts)])
    eye = np.eye(size)
    for start, contact, least, most in zip(starts, contacts, preload, cap, strict=False):
        normal = eye[start + contact.normal]
        rows.append(normal)
        offsets.append(-least)
        if np.isfinite(most):
            rows.append(-normal)
            offsets.append(most)

    blocks = [contact.coefficients() for contact in contacts]
    widths = tuple(block.shape[-1] for block in blocks)
    friction_size = sum(widths)
    total = friction_size + len(rows)
    coefficients = np.zeros((size, total, total))
    corner = 0
    for start, width, block in zip(starts, widths, blocks, strict=False):
        place = slice(corner, corner + width)
        coefficients[start : start + len(block), place, place] = block
        corner += width
    diagonal = np.arange(friction_size, total)
    coefficients[:, diagonal, diagonal] = np.transpose(rows)
    constant = np.zeros((total, total))
    constant[diagonal, diagonal] = offsets
    return LinearMatrixInequality(constant, coefficients, widths, torque_size)


def linear_matrix_inequality(problem: GraspForceProblem) -> LinearMatrixInequality:
    """D_0 and D_l of one numpy problem, with PCWF throughout; N and N·m as in the problem."""
    return contact_inequality(
        [FrictionContact(float(friction)) for friction in problem.friction],
        problem.hand_jacobian,
        problem.torque_min,
        problem.torque_max,
        problem.external_torque,
        problem.normal_min,
        problem.normal_max,
    )


def _array(
    name: str,
    value: Any,
    shape: tuple[int, ...],
    default: float | None = None,
    infinite: float | None = None,
) -> np.ndarray:
    """The value as float64 of one shape, finite but for `infinite`."""
    if value is None and default is not None:
        return np.full(shape, default)
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ProblemError(f"{name} is not a rectangular array of numbers") from error
    if array.shape != shape:
        raise ProblemError(f"{name} has shape {array.shape} but must have {shape}")
    if not np.all(np.isfinite(array) | (array == infinite)):
        raise ProblemError(f"{name} contains NaN, or a value that must not be infinite")
    return array


class LmiSolver(InstanceSolver):
    """The linear matrix inequality as a semidefinite program that cvxpy builds.

    An independent route to the same optimum, for checks and for readers of the paper; slow.

    Args:
        backend: who solves the program, one of `BACKENDS`.

    Raises:
        SolverError: for an unknown backend.
        MissingDependencyError: if cvxpy or the backend is not installed.
    """

    def __init__(self, backend: str = "clarabel") -> None:
        if backend not in BACKENDS:
            raise SolverError(
                f"unknown backend {backend!r} of the solver 'lmi'; choose one of "
                f"{', '.join(BACKENDS)}"
            )
        missing = [package for package in ("cvxpy", backend) if find_spec(package) is None]
        if missing:
            raise MissingDependencyError(
                f"the solver 'lmi' needs {' and '.join(missing)}; install with: "
                f"pip install {' '.join(missing)}"
            )
        import cvxpy

        self._cvxpy = cvxpy
        self._backend = backend

    def propose_one(self, problem: GraspForceProblem) -> Candidate:
        """Forces and multipliers of one problem; on infeasibility, a Farkas vector.

        The multipliers are the duals of the equilibrium rows and of the torque rows.
        """
        cp = self._cvxpy
        scale = float(force_scale(problem))
        rows = np.repeat([1.0, 1.0 / float(moment_arm(problem))], 3)
        inequality = linear_matrix_inequality(problem)
        x = cp.Variable(3 * problem.n_contacts)
        equilibrium = (rows[:, None] * problem.grasp_map) @ x == (
            -rows * problem.external_wrench / scale
        )
        constraints = [equilibrium]
        for start in range(0, inequality.friction_size, 3):
            block = np.s_[start : start + 3]
            local = inequality.coefficients[block, block, block]
            constraints.append(sum(x[start + k] * local[k] for k in range(3)) >> 0)
        tail = np.arange(inequality.friction_size, inequality.constant.shape[0])
        slopes = inequality.coefficients[:, tail, tail].T
        offsets = inequality.constant[tail, tail] / scale
        weights = _row_weights(slopes, offsets)
        constraints.append((weights[:, None] * slopes) @ x + weights * offsets >= 0)
        goals = {
            "min_norm": 0.5 * cp.sum_squares(x),
            "sum_normal": cp.sum(x[2::3]),
            "min_max_normal": cp.max(x[2::3]),
        }
        program = cp.Problem(cp.Minimize(goals[problem.objective]), constraints)
        try:
            with warnings.catch_warnings():
                # the message says it, and how accurate the answer is, the judge measures
                warnings.filterwarnings("ignore", "Solution may be inaccurate", UserWarning)
                program.solve(solver=self._backend.upper(), **BACKENDS[self._backend])
        except cp.SolverError as error:
            return self._candidate(problem, f"cvxpy: {error}")
        status = str(program.status)
        message = "" if status == "optimal" else f"{self._backend} ended with {status}"
        forces = None if x.value is None else scale * np.asarray(x.value)
        duals = (equilibrium.dual_value, constraints[-1].dual_value)
        if any(dual is None for dual in duals):
            return self._candidate(problem, message, forces)
        unit = scale if problem.objective == "min_norm" else 1.0
        price = _torque_prices(problem, weights * duals[1])
        return self._candidate(
            problem, message, forces, Multipliers(unit * rows * duals[0], unit * price)
        )

    @staticmethod
    def _candidate(
        problem: GraspForceProblem,
        message: str,
        forces: np.ndarray | None = None,
        multipliers: Multipliers | None = None,
    ) -> Candidate:
        """What there is; NaN for what there is not."""
        if forces is None:
            forces = np.full(3 * problem.n_contacts, np.nan)
        if multipliers is None:
            multipliers = Multipliers(np.full(6, np.nan), np.full(problem.n_joints, np.nan))
        return Candidate(forces, multipliers, np.array(message))


def _row_weights(slopes: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """(k,) what brings rows of slopes and offsets to length one, less where an offset exceeds one.

    Limits far beyond the scale of the forces would otherwise hide the rest from the backends'
    relative tolerances.
    """
    length = np.linalg.norm(slopes, axis=1)
    weights = 1.0 / np.where(length > 0.0, length, 1.0)
    return weights / np.maximum(1.0, np.abs(weights * offsets))


def _torque_prices(problem: GraspForceProblem, duals: np.ndarray) -> np.ndarray:
    """(n_tau,) lambda from the duals of T_L and T_U, which lead."""
    below, above = np.isfinite(problem.torque_min), np.isfinite(problem.torque_max)
    lower_count, upper_count = int(below.sum()), int(above.sum())
    price = np.zeros(problem.n_joints)
    price[below] -= duals[:lower_count]
    price[above] += duals[lower_count : lower_count + upper_count]
    return price
