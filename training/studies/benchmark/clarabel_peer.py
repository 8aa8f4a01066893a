"""Clarabel, with a new solver object for every problem and with one whose data are updated."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .conic import EQUALITIES, ConicBatch, csc
from .peers import Peer, RawAnswer, needed, quadratic, spread_duals, without_answers


class ClarabelPeer(Peer):
    """Clarabel, a new solver object for every problem."""

    title = "Clarabel"
    package = "clarabel"
    settings = "defaults (1e-8), one thread"

    def convert(self, part: ConicBatch) -> Any:
        """P, q, A, b, K of each problem, with its own sparsity."""
        import clarabel

        cost, linear = quadratic(part)
        programs = []
        for problem in range(len(part)):
            matrix, bound, rows = needed(part, problem)
            inequalities = int(rows.sum()) - EQUALITIES - part.n_variables
            cones = [
                clarabel.ZeroConeT(EQUALITIES),
                clarabel.NonnegativeConeT(inequalities),
                *[clarabel.SecondOrderConeT(3)] * part.n_contacts,
            ]
            programs.append(((cost, linear, matrix, bound, cones), rows))
        return programs

    def solve_part(self, program: Any) -> Any:
        """Clarabel's solutions, with the rows that they are of."""
        import clarabel

        settings = self._settings()
        return [(clarabel.DefaultSolver(*data, settings).solve(), rows) for data, rows in program]

    def read(self, part: ConicBatch, raw: Any) -> RawAnswer:
        """See the base."""
        none = ["Infeasible" in str(solution.status) for solution, _ in raw]
        x = np.array([solution.x for solution, _ in raw])
        duals = spread_duals([rows for _, rows in raw], [solution.z for solution, _ in raw])
        return without_answers(x, none), duals

    @staticmethod
    def _settings() -> Any:
        import clarabel

        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.max_threads = 1
        return settings


class ClarabelUpdatePeer(ClarabelPeer):
    """Clarabel, one solver object for each number of contacts, whose data are updated.

    The sparsity must not change, so that absent limits are rows 0'x <= 1 and J_h is taken as dense.
    """

    title = "Clarabel (update)"
    settings = "defaults (1e-8), one thread, presolve off, one sparsity for each number of contacts"

    def __init__(self) -> None:
        self._solvers: dict[tuple[int, int], Any] = {}

    def convert(self, part: ConicBatch) -> Any:
        """The entries of A and b; the solver of that sparsity, made on the first occasion."""
        pattern = part.pattern()
        columns, rows = np.nonzero(pattern.T)
        key = (part.n_contacts, part.n_joints)
        if key not in self._solvers:
            self._solvers[key] = self._solver(part, pattern)
        return self._solvers[key], part.matrix[:, rows, columns], part.bound

    def solve_part(self, program: Any) -> Any:
        """Clarabel's solutions, of all rows."""
        solver, entries, bounds = program
        solutions = []
        for matrix, bound in zip(entries, bounds, strict=True):
            solver.update(A=matrix, b=bound)
            solutions.append((solver.solve(), np.ones(len(bound), dtype=np.bool_)))
        return solutions

    def _solver(self, part: ConicBatch, pattern: NDArray[np.bool_]) -> Any:
        import clarabel

        settings = self._settings()
        settings.presolve_enable = False
        cost, linear = quadratic(part)
        cones = [
            clarabel.ZeroConeT(EQUALITIES),
            clarabel.NonnegativeConeT(part.n_inequalities),
            *[clarabel.SecondOrderConeT(3)] * part.n_contacts,
        ]
        matrix = csc(part.matrix[0], pattern)
        return clarabel.DefaultSolver(cost, linear, matrix, part.bound[0], cones, settings)
