"""The paper's form: friction cones and torque limits as one linear matrix inequality.

D(x) = D_0 + sum_l x_l D_l = blockdiag(P_1(x), ..., P_n(x), T_L(x), T_U(x), N_L(x), N_U(x)) >= 0
holds exactly where the cone constraints hold (Basumatary et al., equations 26 to 35; the matrices
S_l that the paper leaves undefined are the D_l restricted to the friction blocks). N_L and N_U, the
preload and the cap, are added here.
"""

import warnings
from dataclasses import dataclass

import numpy as np

from .base import InstanceSolver
from .certificates import Multipliers
from .exceptions import MissingDependencyError
from .problem import GraspForceProblem
from .scaling import force_scale, moment_arm
from .solution import Candidate


@dataclass(frozen=True, eq=False)
class LinearMatrixInequality:
    """D(x) = constant + sum_l x_l coefficients[l] >= 0, block diagonal, symmetric.

    Args:
        constant: (m, m) D_0.
        coefficients: (3n, m, m) D_l; the force components are x.
        friction_size: 3n; the leading diagonal blocks P_i are 3 by 3, all that follow are 1 by 1.
    """

    constant: np.ndarray
    coefficients: np.ndarray
    friction_size: int

    def __call__(self, forces: np.ndarray) -> np.ndarray:
        """(..., m, m) D(x) at forces (..., 3n)."""
        return self.constant + np.tensordot(forces, self.coefficients, axes=(-1, 0))


def linear_matrix_inequality(problem: GraspForceProblem) -> LinearMatrixInequality:
    """D_0 and D_l of one numpy problem; infinite limits have no row; N and N·m as in the problem.

    A contact's block is P = [[mu f_n, 0, f_t1], [0, mu f_n, f_t2], [f_t1, f_t2, mu f_n]], with
    eigenvalues mu f_n and mu f_n +- |f_t|.
    """
    n = problem.n_contacts
    rows: list[np.ndarray] = []
    offsets: list[float] = []
    eye = np.eye(3 * n)
    for joint in range(problem.n_joints):
        column = problem.hand_jacobian[:, joint]
        offset = float(problem.external_torque[joint])
        if np.isfinite(problem.torque_min[joint]):
            rows.append(column)
            offsets.append(offset - float(problem.torque_min[joint]))
        if np.isfinite(problem.torque_max[joint]):
            rows.append(-column)
            offsets.append(float(problem.torque_max[joint]) - offset)
    for contact in range(n):
        normal = eye[3 * contact + 2]
        # also where the preload is zero: a frictionless block says nothing about f_n
        rows.append(normal)
        offsets.append(-float(problem.normal_min[contact]))
        if np.isfinite(problem.normal_max[contact]):
            rows.append(-normal)
            offsets.append(float(problem.normal_max[contact]))
    size = 3 * n + len(rows)
    coefficients = np.zeros((3 * n, size, size))
    for contact in range(n):
        first, second, normal_index = 3 * contact + np.arange(3)
        coefficients[first, first, normal_index] = coefficients[first, normal_index, first] = 1.0
        coefficients[second, second, normal_index] = 1.0
        coefficients[second, normal_index, second] = 1.0
        for diagonal in (first, second, normal_index):
            coefficients[normal_index, diagonal, diagonal] = problem.friction[contact]
    constant = np.zeros((size, size))
    for index, (row, offset) in enumerate(zip(rows, offsets, strict=True), start=3 * n):
        coefficients[:, index, index] = row
        constant[index, index] = offset
    return LinearMatrixInequality(constant, coefficients, 3 * n)


class LmiSolver(InstanceSolver):
    """The linear matrix inequality as a semidefinite program: cvxpy builds it, Clarabel solves it.

    An independent route to the same optimum, for checks and for readers of the paper; slow.
    """

    def __init__(self) -> None:
        try:
            import cvxpy
        except ImportError as error:
            raise MissingDependencyError(
                "the solver 'lmi' needs cvxpy; install it with: pip install cvxpy"
            ) from error
        self._cvxpy = cvxpy

    def propose_one(self, problem: GraspForceProblem) -> Candidate:
        """Forces of one problem, and nu from the equilibrium rows of the semidefinite program."""
        cp = self._cvxpy
        scale = float(force_scale(problem))
        rows = np.repeat([1.0, 1.0 / float(moment_arm(problem))], 3)
        inequality = linear_matrix_inequality(problem)
        size = 3 * problem.n_contacts
        x = cp.Variable(size)
        equilibrium = (rows[:, None] * problem.grasp_map) @ x == (
            -rows * problem.external_wrench / scale
        )
        constraints = [equilibrium]
        for start in range(0, inequality.friction_size, 3):
            block = np.s_[start : start + 3]
            local = inequality.coefficients[block, block, block]
            constraints.append(sum(x[start + k] * local[k] for k in range(3)) >> 0)
        tail = np.arange(inequality.friction_size, inequality.constant.shape[0])
        diagonal = inequality.coefficients[:, tail, tail].T
        constraints.append(diagonal @ x + inequality.constant[tail, tail] / scale >= 0)
        goal = 0.5 * cp.sum_squares(x) if problem.objective == "min_norm" else cp.sum(x[2::3])
        program = cp.Problem(cp.Minimize(goal), constraints)
        accuracy = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), 1e-10)
        try:
            with warnings.catch_warnings():
                # how accurate the answer is, the judge measures
                warnings.filterwarnings("ignore", "Solution may be inaccurate", UserWarning)
                program.solve(solver=cp.CLARABEL, **accuracy)
        except cp.SolverError as error:
            return self._none(problem, f"cvxpy: {error}")
        if x.value is None:
            return self._none(problem, f"cvxpy ended with {program.status}")
        dual_scale = scale if problem.objective == "min_norm" else 1.0
        price = self._torque_prices(problem, constraints[-1].dual_value) * dual_scale
        nu = dual_scale * rows * np.asarray(equilibrium.dual_value)
        return Candidate(scale * np.asarray(x.value), Multipliers(nu, price), np.array(""))

    @staticmethod
    def _torque_prices(problem: GraspForceProblem, duals: np.ndarray) -> np.ndarray:
        price = np.zeros(problem.n_joints)
        index = 0
        for joint in range(problem.n_joints):
            if np.isfinite(problem.torque_min[joint]):
                price[joint] -= duals[index]
                index += 1
            if np.isfinite(problem.torque_max[joint]):
                price[joint] += duals[index]
                index += 1
        return price

    @staticmethod
    def _none(problem: GraspForceProblem, message: str) -> Candidate:
        return Candidate(
            np.full(3 * problem.n_contacts, np.nan),
            Multipliers(np.full(6, np.nan), np.full(problem.n_joints, np.nan)),
            np.array(message),
        )
