"""Batches of problems through the Newton kernel: eight side by side, the rest one by one."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from solvers.arrays import Array
from solvers.problem import GraspForceProblem

from ..arrays import ProblemArrays, one_of
from ..cache import digest
from ..lanes import KERNEL, WIDTH, lanes
from .ascent import INFEASIBLE, SOLVED, UNFINISHED, newton_ascent, start
from .layout import Layout, layout
from .setup import gather, prepare

_CHUNK = 1024
"""Problems that a thread takes at a time."""

_ALONE = 60
"""Newton steps for a problem on its own."""

_TOGETHER = 20
"""And side by side: eight take as long as the slowest of them."""


@njit(**KERNEL)
def _scatter(
    ws: Any, at: Layout, lane: int, width: int, problem: ProblemArrays, forces: Any, nu: Any,
    price: Any,
) -> None:  # fmt: skip
    """Read one lane's answer in original units."""
    contact_mask, normal_min, normal_max = (
        problem.contact_mask, problem.normal_min, problem.normal_max,
    )  # fmt: skip
    scale = ws[at.scale * width + lane]
    code = ws[at.code * width + lane]
    k = 0
    for contact in range(contact_mask.shape[0]):
        for axis in range(3):
            f = 0.0
            if contact_mask[contact] and code == SOLVED:
                f = scale * ws[(at.answer + 3 * k + axis) * width + lane]
            forces[3 * contact + axis] = f
        if contact_mask[contact]:
            k += 1
            if code == SOLVED:
                # scaling back and forth may cost a unit in the last place
                normal = min(forces[3 * contact + 2], normal_max[contact])
                forces[3 * contact + 2] = max(normal, normal_min[contact])
    per_arm = 1.0 / ws[at.row_scale * width + lane]
    for r in range(5, -1, -1):
        total = ws[(at.answer_y + r) * width + lane]
        for t in range(r + 1, 6):
            total -= ws[(at.factor + 6 * t + r) * width + lane] * nu[t]
        nu[r] = total * ws[(at.factor + 7 * r) * width + lane]
    for r in range(6):
        nu[r] *= scale * (1.0 if r < 3 else per_arm)
    for j in range(at.m):
        column = ws[(at.column + j) * width + lane]
        price[j] = scale * ws[(at.answer_price + j) * width + lane] / column


@njit(**KERNEL)
def _solve_alone(
    rows: Any, problems: ProblemArrays, forces: Any, nu: Any, price: Any, code: Any, steps: Any
) -> None:
    """Solve the problems at the indices `rows`, one by one."""
    n, m = problems.friction.shape[1], problems.torque_min.shape[1]
    active = np.zeros(6 + m, dtype=np.int64)
    ws = np.zeros(layout(n, m).length)
    for b in rows:
        problem = one_of(problems, b)
        at = layout(_contacts(problem.contact_mask), m)
        gather(ws, at, 0, 1, problem)
        prepare(ws, at, 0.0)
        start(ws, at, 0.0)
        newton_ascent(ws, at, active, _ALONE, 0.0)
        _scatter(ws, at, 0, 1, problem, forces[b], nu[b], price[b])
        code[b] = int(ws[at.code])
        steps[b] = int(ws[at.steps])


@njit(**KERNEL)
def _contacts(contact_mask: Any) -> int:
    total = 0
    for contact in range(contact_mask.shape[0]):
        if contact_mask[contact]:
            total += 1
    return total


@njit(**KERNEL)
def _solve_together(
    rows: Any, problems: ProblemArrays, forces: Any, nu: Any, price: Any, code: Any, steps: Any
) -> Any:
    """The same, eight at a time; the contacts of eight neighbours should be about as many.

    Returns:
        Those that take longer than `_TOGETHER` steps, and what is left of the last eight.
    """
    n, m = problems.friction.shape[1], problems.torque_min.shape[1]
    active = np.zeros(6 + m, dtype=np.int64)
    zero = lanes(0.0)
    ws = np.zeros(WIDTH * layout(n, m).length)
    alone = rows.copy()
    left = 0
    whole = len(rows) - len(rows) % WIDTH
    for first in range(0, whole, WIDTH):
        largest = 0
        for lane in range(WIDTH):
            largest = max(largest, _contacts(problems.contact_mask[rows[first + lane]]))
        at = layout(largest, m)
        for lane in range(WIDTH):
            gather(ws, at, lane, WIDTH, one_of(problems, rows[first + lane]))
        prepare(ws, at, zero)
        start(ws, at, zero)
        newton_ascent(ws, at, active, _TOGETHER, zero)
        for lane in range(WIDTH):
            b = rows[first + lane]
            code[b] = int(ws[at.code * WIDTH + lane])
            if code[b] == UNFINISHED:
                alone[left] = b
                left += 1
                continue
            _scatter(ws, at, lane, WIDTH, one_of(problems, b), forces[b], nu[b], price[b])
            steps[b] = int(ws[at.steps * WIDTH + lane])
    for b in rows[whole:]:
        alone[left] = b
        left += 1
    return alone[:left]


def _entries(sources: str) -> tuple[Any, Any]:
    @njit(cache=True, nogil=True, **KERNEL)
    def solve_alone(rows, arrays, out):  # type: ignore[no-untyped-def]
        sources  # noqa: B018 - see `cache.digest`
        _solve_alone(rows, ProblemArrays(*arrays), *out)

    @njit(cache=True, nogil=True, **KERNEL)
    def solve_together(rows, arrays, out):  # type: ignore[no-untyped-def]
        sources  # noqa: B018
        return _solve_together(rows, ProblemArrays(*arrays), *out)

    return solve_alone, solve_together


_alone, _together = _entries(digest())


@dataclass(frozen=True, eq=False)
class Ascent:
    """Answers of the Newton kernel to B problems, in their own units.

    Args:
        forces: (B, 3n) N; zero where there are none.
        equilibrium_dual: (B, 6) nu.
        torque_dual: (B, n_tau) lambda.
        code: (B,) `ascent.SOLVED`, `INFEASIBLE`, `STUCK` or `UNFINISHED`.
        steps: (B,) Newton steps.
    """

    forces: Array
    equilibrium_dual: Array
    torque_dual: Array
    code: NDArray[np.int64]
    steps: NDArray[np.int64]

    @property
    def solved(self) -> NDArray[np.bool_]:
        """(B,) whether the forces are the optimum."""
        return self.code == SOLVED

    @property
    def infeasible(self) -> NDArray[np.bool_]:
        """(B,) whether the multipliers prove that there are no forces."""
        return self.code == INFEASIBLE


def solve_batch(problem: GraspForceProblem, threads: int = 1) -> Ascent:
    """Solve `min_norm` problems; the answers do not depend on the number of threads.

    Args:
        problem: float64 numpy, one batch dimension.
        threads: of this process; each takes a chunk of problems at a time.
    """
    arrays = problem.plain_arrays(1)
    count, n_tau = len(problem), problem.n_joints
    answer = Ascent(
        np.zeros((count, 3 * problem.n_contacts)),
        np.zeros((count, 6)),
        np.zeros((count, n_tau)),
        np.zeros(count, dtype=np.int64),
        np.zeros(count, dtype=np.int64),
    )
    out = (answer.forces, answer.equilibrium_dual, answer.torque_dual, answer.code, answer.steps)

    def solve_rows(rows: NDArray[np.int64]) -> None:
        _alone(_together(rows, arrays, out) if len(rows) >= WIDTH else rows, arrays, out)

    if count < WIDTH:
        solve_rows(np.arange(count))
        return answer
    # neighbours with about as many contacts waste least
    order = np.argsort(problem.contact_mask.sum(axis=1), kind="stable")
    chunks = [order[start : start + _CHUNK] for start in range(0, count, _CHUNK)]
    if threads == 1 or len(chunks) == 1:
        for chunk in chunks:
            solve_rows(chunk)
    else:
        with ThreadPoolExecutor(threads) as pool:
            for _ in pool.map(solve_rows, chunks):
                pass
    return answer
