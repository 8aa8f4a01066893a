"""Contact synthesis as a bilinear matrix inequality, lifted to a semidefinite program.

Positions s_i on facets and forces f_ik under loads k = 0 ... K are sought together. Equilibrium
G(s) f_k = t n d_k is bilinear in (s, f), and G G' >= eps I quadratic in s (Basumatary et al.,
"Grasp Force Optimization as a Bilinear Matrix Inequality Problem", equations 18 to 21, after Dai,
Majumdar and Tedrake, "Synthesis and optimization of force closure grasps via sequential
semidefinite programming", 2018). Every product is replaced by an entry of a matrix variable
(equations 6 and 7). Only products within one contact and one load occur, so of the paper's
M = [[X, x], [x', 1]] only the blocks

    M_ik = [[S_i, P_ik, s_i], [P_ik', F_ik, f_ik], [s_i', f_ik', 1]] >= 0         (6 by 6)

are needed; blocks of one contact share S_i and s_i. Their pattern is chordal: whatever the other
entries of M, they can be completed so that M >= 0 with the rank of the largest block (Grone et
al. 1984, Dancis 1992). So M has rank one exactly if every block has.

The relaxation is tightened by products that are valid at rank one: each side of the facet times
the friction cone, and sides times sides.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from solvers.arrays import Array
from solvers.conic import POSITIVE, SECOND_ORDER, SEMIDEFINITE, ZERO, solve
from solvers.exceptions import ProblemError, SolverError

from .facets import ContactFacets

Index = NDArray[np.int64]

INTERIOR_FRICTION = 0.95
"""Share of mu within which internal forces must stay: strictly inside their cones."""

INTERIOR_PRELOAD = 0.05
"""Least normal force of the internal forces, where their mean is one: strictly positive."""

GRASP_MATRIX_FLOOR = 1e-3
"""eps of G G' >= eps I, torques over the characteristic length."""

_CONE_ORDER = [2, 0, 1]
_TRIANGLE = np.array([(row, column) for column in range(6) for row in range(column + 1)]).T
_TRIANGLE_WEIGHT = np.where(_TRIANGLE[0] == _TRIANGLE[1], 1.0, np.sqrt(2.0))


@dataclass(frozen=True, eq=False)
class LiftedPoint:
    """Values of the variables of a `LiftedSynthesis`.

    Args:
        local: (n, 2) s, local coordinates on the facets.
        forces: (n, 1 + K, 3) f in contact frames, the mean normal force at most one; load 0 is
            the internal one.
        reach: t, N of load that one newton of total normal force carries along every d_k.
        blocks: (n, 1 + K, 6, 6) M_ik, ordered s, f, 1.
    """

    local: Array
    forces: Array
    reach: float
    blocks: Array

    @property
    def eigenvalue_ratio(self) -> float:
        """Largest ratio of second to first eigenvalue over all blocks; 0 is rank one."""
        values = np.linalg.eigvalsh(self.blocks)
        return float((values[..., -2] / values[..., -1]).max())


@dataclass
class _Rows:
    """Rows b - A x in K, gathered block by block."""

    entries: list[tuple[Index, Index, Array]] = field(default_factory=list)
    bounds: list[Array] = field(default_factory=list)
    cones: list[object] = field(default_factory=list)
    count: int = 0

    def add(self, cone: object, bound: Array, *terms: tuple[Index, Array]) -> None:
        """One cone: bound (r,) less the sum of coefficients (r, c) times the variables (c,)."""
        size = len(bound)
        for columns, coefficients in terms:
            rows = np.repeat(np.arange(self.count, self.count + size), len(columns))
            self.entries.append((rows, np.tile(columns, size), np.ravel(coefficients)))
        self.bounds.append(bound)
        self.cones.append(cone)
        self.count += size

    def matrix(self, variables: int) -> sparse.csc_matrix:
        rows, columns, values = (np.concatenate(part) for part in zip(*self.entries, strict=True))
        return sparse.csc_matrix((values, (rows, columns)), shape=(self.count, variables))


class LiftedSynthesis:
    """The semidefinite relaxation over contacts on given facets, for given loads.

    maximise t subject to, in lifted variables,

    - load 0, the internal forces: G f_0 = 0, |f_t| <= 0.95 mu f_n, f_n >= 0.05, sum f_n = n;
    - load k >= 1: G f_k = t n d_k, |f_t| <= mu f_n, sum f_n <= n;
    - G G' >= eps I, and every s_i on its facet.

    Without loads there is nothing to maximise: any point that satisfies the paper's equations 18
    to 21 will do.

    Args:
        facets: one for each contact.
        loads: (K, 6) directions d_k, torques over the facets' `length`.

    Raises:
        ProblemError: for loads of another shape, that are not finite, or that are zero.
    """

    def __init__(self, facets: ContactFacets, loads: Array) -> None:
        if not isinstance(facets, ContactFacets):
            raise ProblemError(f"ContactFacets must be given, not {type(facets).__name__}")
        self.facets = facets
        try:
            self.loads = np.array(loads, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise ProblemError("loads must be an array of numbers of shape (K, 6)") from error
        if self.loads.ndim != 2 or self.loads.shape[1] != 6:
            raise ProblemError(f"loads must have shape (K, 6), not {self.loads.shape}")
        if not np.isfinite(self.loads).all() or not self.loads.any(axis=1).all():
            raise ProblemError("loads must be finite, and none may be zero: every reach carries it")
        n, count = len(facets), 1 + len(self.loads)
        numbers = iter(range(1 + n * 5 + n * count * 15))

        def take(*shape: int) -> Index:
            size = int(np.prod(shape))
            return np.array([next(numbers) for _ in range(size)], dtype=np.int64).reshape(shape)

        self._reach = take(1)
        self._local = take(n, 2)
        self._second = _symmetric(take(n, 3), 2)
        self._force = take(n, count, 3)
        self._product = take(n, count, 2, 3)
        square = _symmetric(take(n, count, 6), 3)
        self._size = 1 + n * 5 + n * count * 15
        # the constant 1 in the corner of each block is no variable: -1 here
        self._blocks = np.full((n, count, 6, 6), -1, dtype=np.int64)
        self._blocks[..., :2, :2] = self._second[:, None]
        self._blocks[..., :2, 2:5] = self._product
        self._blocks[..., 2:5, :2] = np.swapaxes(self._product, -1, -2)
        self._blocks[..., 2:5, 2:5] = square
        self._blocks[..., :2, 5] = self._blocks[..., 5, :2] = self._local[:, None]
        self._blocks[..., 2:5, 5] = self._blocks[..., 5, 2:5] = self._force

        rows = _Rows()
        self._balance(rows)
        self._normal_sums(rows)
        for contact in range(n):
            self._facet(rows, contact)
            for load in range(count):
                self._friction(rows, contact, load)
                self._positive(rows, self._blocks[contact, load])
        self._grasp_matrix(rows)
        self._matrix = rows.matrix(self._size)
        self._bound = np.concatenate(rows.bounds)
        self._cones = rows.cones

    def solve(self, towards: LiftedPoint | None = None, penalty: float = 0.0) -> LiftedPoint:
        """The optimum of the relaxation, or of a step towards rank one.

        The step adds `penalty` times the sum over all blocks of trace(M) - v' M v, where v is the
        unit vector along (s, f, 1) of `towards`, the leading eigenvector if that is of rank one:
        the sum is zero only where every M is a multiple of its v v'. The eigenvector itself would
        be misled by the relaxation, which leaves F free to be as large as it likes.

        Raises:
            SolverError: if Clarabel finds no point, in its own words.
        """
        cost = np.zeros(self._size)
        if len(self.loads):
            cost[self._reach] = -1.0
        if towards is not None:
            point = towards.blocks[..., 5]
            point = point / np.linalg.norm(point, axis=-1, keepdims=True)
            weight = np.eye(6) - point[..., :, None] * point[..., None, :]
            variable = self._blocks >= 0
            np.add.at(cost, self._blocks[variable], penalty * weight[variable])
        outcome = solve(None, cost, self._matrix, self._bound, self._cones)
        if not outcome.solved:
            raise SolverError(f"Clarabel ended with {outcome.status}")
        values = outcome.x
        blocks = np.where(self._blocks >= 0, values[self._blocks], 1.0)
        return LiftedPoint(
            local=values[self._local],
            forces=values[self._force],
            reach=float(values[0]),
            blocks=blocks,
        )

    def _balance(self, rows: _Rows) -> None:
        """G(s) f_k = t n d_k, in which s f' is the block's P."""
        n, facets = len(self.facets), self.facets
        for load in range(1 + len(self.loads)):
            terms = []
            for contact in range(n):
                terms.append((self._force[contact, load], facets.base[contact]))
                for axis in (0, 1):
                    slope = facets.slope[contact, axis]
                    terms.append((self._product[contact, load, axis], slope))
            if load:
                terms.append((self._reach, -n * self.loads[load - 1][:, None]))
            rows.add(ZERO(6), np.zeros(6), *terms)

    def _normal_sums(self, rows: _Rows) -> None:
        n = len(self.facets)
        for load in range(1 + len(self.loads)):
            cone = POSITIVE(1) if load else ZERO(1)
            rows.add(cone, np.array([float(n)]), (self._force[:, load, 2], np.ones((1, n))))

    def _facet(self, rows: _Rows, contact: int) -> None:
        """Sides, (b - A s) >= 0, and their products with each other."""
        sides, bounds = self.facets.sides[contact]
        rows.add(POSITIVE(len(sides)), bounds, (self._local[contact], sides))
        first, second = np.triu_indices(len(sides))
        mixed = bounds[first, None] * sides[second] + bounds[second, None] * sides[first]
        squares = (sides[first, :, None] * sides[second, None, :]).reshape(len(first), 4)
        rows.add(
            POSITIVE(len(first)),
            bounds[first] * bounds[second],
            (self._local[contact], mixed),
            (self._second[contact].reshape(4), -squares),
        )

    def _friction(self, rows: _Rows, contact: int, load: int) -> None:
        """The cone itself, and (b - A s) times it for every side."""
        share = 1.0 if load else INTERIOR_FRICTION
        weight = np.diag([share * self.facets.friction[contact], 1.0, 1.0])
        force = self._force[contact, load][_CONE_ORDER]
        products = self._product[contact, load][:, _CONE_ORDER]
        if not load:
            rows.add(
                POSITIVE(1),
                np.array([-INTERIOR_PRELOAD]),
                (force[:1], -np.ones((1, 1))),
            )
        rows.add(SECOND_ORDER(3), np.zeros(3), (force, -weight))
        for side, bound in zip(*self.facets.sides[contact], strict=True):
            rows.add(
                SECOND_ORDER(3),
                np.zeros(3),
                (force, -bound * weight),
                *((products[axis], side[axis] * weight) for axis in (0, 1)),
            )

    @staticmethod
    def _positive(rows: _Rows, block: Index) -> None:
        """M_ik >= 0, as its upper triangle by columns with off-diagonals times the root of 2."""
        columns = block[_TRIANGLE[0], _TRIANGLE[1]]
        variable = columns >= 0
        entries = -np.diag(_TRIANGLE_WEIGHT)[:, variable]
        rows.add(SEMIDEFINITE(6), 1.0 * ~variable, (columns[variable], entries))

    def _grasp_matrix(self, rows: _Rows) -> None:
        """G G' >= eps I, quadratic in s and so linear in (s, S)."""
        base, slope = self.facets.base, self.facets.slope
        constant = np.einsum("nij,nkj->ik", base, base) - GRASP_MATRIX_FLOOR * np.eye(6)
        linear = np.einsum("naij,nkj->naik", slope, base)
        linear = linear + np.swapaxes(linear, -1, -2)
        square = np.einsum("naij,nbkj->nabik", slope, slope)
        square = 0.5 * (square + np.swapaxes(square, -1, -2))

        def triangle(matrices: Array) -> Array:
            return matrices[..., _TRIANGLE[0], _TRIANGLE[1]] * _TRIANGLE_WEIGHT

        rows.add(
            SEMIDEFINITE(6),
            triangle(constant),
            (self._local.reshape(-1), -triangle(linear).reshape(-1, 21).T),
            (self._second.reshape(-1), -triangle(square).reshape(-1, 21).T),
        )


def _symmetric(triangle: Index, size: int) -> Index:
    """(..., size, size) symmetric matrices of the numbers of their upper triangles."""
    rows, columns = np.triu_indices(size)
    matrix = np.zeros((*triangle.shape[:-1], size, size), dtype=np.int64)
    matrix[..., rows, columns] = triangle
    matrix[..., columns, rows] = triangle
    return matrix
