"""Moreau, which solves many problems of one sparsity in one call."""

from typing import Any

import numpy as np
from scipy import sparse

from .conic import EQUALITIES, ConicBatch
from .peers import Peer, RawAnswer, without_answers


class MoreauPeer(Peer):
    """Moreau's batched interface on the CPU.

    Problems with as many contacts share a sparsity; its compiled solver is made once for each
    sparsity and batch size, outside the timing, as it is meant to be used.
    """

    title = "Moreau"
    package = "moreau"
    settings = "defaults (1e-8), device cpu, compiled once for each number of contacts"
    batched = True

    def __init__(self) -> None:
        self._compiled: dict[tuple[int, int, int], Any] = {}

    def convert(self, part: ConicBatch) -> Any:
        """The compiled solver and the entries of P, A, q, b."""
        pattern = part.pattern()
        rows, columns = np.nonzero(pattern)
        key = (part.n_contacts, part.n_joints, len(part))
        if key not in self._compiled:
            self._compiled[key] = _compile(part, sparse.csr_matrix(pattern.astype(np.float64)))
        shape = (len(part), part.n_variables)
        return (
            self._compiled[key],
            np.ones(shape),
            part.matrix[:, rows, columns],
            np.zeros(shape),
            part.bound,
        )

    def solve_part(self, program: Any) -> Any:
        """Moreau's batched solution and its statuses."""
        solver, cost, entries, linear, bound = program
        solver.setup(cost, entries)
        return solver.solve(linear, bound), list(solver.info.status)

    def read(self, part: ConicBatch, raw: Any) -> RawAnswer:
        """See the base."""
        solution, status = raw
        none = ["PrimalInfeasible" in str(each) for each in status]
        return without_answers(np.asarray(solution.x), none), np.asarray(solution.z)


def _compile(part: ConicBatch, pattern: Any) -> Any:
    import moreau

    size = part.n_variables
    return moreau.CompiledSolver(
        n=size,
        m=part.n_rows,
        P_row_offsets=np.arange(size + 1),
        P_col_indices=np.arange(size),
        A_row_offsets=pattern.indptr,
        A_col_indices=pattern.indices,
        cones=moreau.Cones(
            num_zero_cones=EQUALITIES,
            num_nonneg_cones=part.n_inequalities,
            so_cone_dims=[3] * part.n_contacts,
        ),
        settings=moreau.Settings(device="cpu", batch_size=len(part), solver="ipm"),
    )
