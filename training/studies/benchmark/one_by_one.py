"""ECOS, QOCO and SCS: a new solver object, or call, for every problem."""

from typing import Any

import numpy as np

from .conic import EQUALITIES, ConicBatch, csc
from .peers import Peer, RawAnswer, needed, quadratic, spread_duals, without_answers


class EcosPeer(Peer):
    """ECOS, which has no quadratic objective: the length of x is minimised instead."""

    title = "ECOS"
    package = "ecos"
    settings = "defaults (1e-8), the length of x as objective, in a cone of its own"

    def convert(self, part: ConicBatch) -> Any:
        """c, G, h, dimensions, A, b of each problem, in the variables x and t >= |x|."""
        size = part.n_variables
        cost = np.append(np.zeros(size), 1.0)
        # (t, x) lies in a cone: the rows -t and -x
        length = -np.roll(np.eye(size + 1), 1, axis=0)
        programs = []
        for problem in range(len(part)):
            rows = part.rows_of(problem)
            matrix = np.pad(part.matrix[problem, rows], ((0, 0), (0, 1)))
            bound = part.bound[problem, rows]
            inner = np.vstack([matrix[EQUALITIES:], length])
            dimensions = {
                "l": len(matrix) - EQUALITIES - size,
                "q": [3] * part.n_contacts + [size + 1],
            }
            programs.append(
                (
                    (
                        cost,
                        csc(inner, inner != 0.0),
                        np.append(bound[EQUALITIES:], np.zeros(size + 1)),
                        dimensions,
                        csc(matrix[:EQUALITIES], matrix[:EQUALITIES] != 0.0),
                        bound[:EQUALITIES],
                    ),
                    rows,
                )
            )
        return programs

    def solve_part(self, program: Any) -> Any:
        """ECOS's dictionaries, with the rows that they are of."""
        import ecos

        return [(ecos.solve(*data, verbose=False), rows) for data, rows in program]

    def read(self, part: ConicBatch, raw: Any) -> RawAnswer:
        """See the base; the duals of |x| become those of 1/2 x'x by its length."""
        size = part.n_variables
        none = [answer["info"]["infostring"].find("rimal infeasible") >= 0 for answer, _ in raw]
        x = np.array([answer["x"][:size] for answer, _ in raw])
        duals = spread_duals(
            [rows for _, rows in raw],
            [np.append(answer["y"], answer["z"][: -size - 1]) for answer, _ in raw],
        )
        length = np.where(none, 1.0, np.linalg.norm(x, axis=-1))
        return without_answers(x, none), length[:, None] * duals


class QocoPeer(Peer):
    """QOCO, a new solver object for every problem."""

    title = "QOCO"
    package = "qoco"
    settings = "defaults (1e-7)"

    def convert(self, part: ConicBatch) -> Any:
        """The arguments of QOCO's setup, problem by problem."""
        cost, linear = quadratic(part)
        programs = []
        for problem in range(len(part)):
            rows = part.rows_of(problem)
            matrix, bound = part.matrix[problem, rows], part.bound[problem, rows]
            inner, equal = matrix[EQUALITIES:], matrix[:EQUALITIES]
            programs.append(
                (
                    (
                        part.n_variables,
                        len(inner),
                        EQUALITIES,
                        cost,
                        linear,
                        csc(equal, equal != 0.0),
                        bound[:EQUALITIES],
                        csc(inner, inner != 0.0),
                        bound[EQUALITIES:],
                        len(inner) - part.n_variables,
                        part.n_contacts,
                        np.full(part.n_contacts, 3),
                    ),
                    rows,
                )
            )
        return programs

    def solve_part(self, program: Any) -> Any:
        """QOCO's results, with the rows that they are of."""
        import qoco

        results = []
        for data, rows in program:
            solver = qoco.QOCO()
            solver.setup(*data)
            results.append((solver.solve(), rows))
        return results

    def read(self, part: ConicBatch, raw: Any) -> RawAnswer:
        """See the base; QOCO has no status for infeasibility, its last iterate is judged."""
        x = np.array([result.x for result, _ in raw])
        duals = spread_duals(
            [rows for _, rows in raw], [np.append(result.y, result.z) for result, _ in raw]
        )
        return x, duals


class ScsPeer(Peer):
    """SCS, a first-order method, a new workspace for every problem."""

    title = "SCS"
    package = "scs"
    settings = "eps 1e-8 (its default of 1e-4 certifies nothing here), at most 3,000 iterations"
    _OPTIONS: dict[str, Any] = {  # noqa: RUF012 - never changed
        "verbose": False,
        "eps_abs": 1e-8,
        "eps_rel": 1e-8,
        "max_iters": 3000,
    }

    def convert(self, part: ConicBatch) -> Any:
        """Data and cone of each problem."""
        cost, linear = quadratic(part)
        programs = []
        for problem in range(len(part)):
            matrix, bound, rows = needed(part, problem)
            data = {"P": cost, "A": matrix, "b": bound, "c": linear}
            inequalities = len(bound) - EQUALITIES - part.n_variables
            cone = {"z": EQUALITIES, "l": inequalities, "q": [3] * part.n_contacts}
            programs.append((data, cone, rows))
        return programs

    def solve_part(self, program: Any) -> Any:
        """SCS's dictionaries, with the rows that they are of."""
        import scs

        return [
            (scs.SCS(data, cone, **self._OPTIONS).solve(), rows) for data, cone, rows in program
        ]

    def read(self, part: ConicBatch, raw: Any) -> RawAnswer:
        """See the base."""
        none = ["infeasible" in answer["info"]["status"] for answer, _ in raw]
        x = np.array([answer["x"] for answer, _ in raw])
        duals = spread_duals([rows for _, rows in raw], [answer["y"] for answer, _ in raw])
        return without_answers(x, none), duals
