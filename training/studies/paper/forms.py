"""The paper's forms against each other: matrix inequality and cones, its ODE and the conic one."""

from dataclasses import dataclass

import numpy as np
import torch

from solvers import GraspForceProblem, solve
from solvers.kkt import Cone, ConeProgram, kkt_field
from solvers.paper.lmi import linear_matrix_inequality
from solvers.problem import friction_violation, normal_violation, torque_violation

NEAR_THE_EDGE = 1e-9
"""N or N·m, and least eigenvalue: draws this close to the edge of the set may fall on either side
of it by rounding, and are not counted."""

_STEPS = (0.0, 1e-6, 1e-3, 0.1, 1.0, 10.0)
_DRAWS_A_STEP = 4


@dataclass(frozen=True)
class InequalityCheck:
    """Whether D(x) >= 0 says the same as the cones and the torque limits.

    Args:
        draws: forces that were tried, those at the edge left out.
        inside: how many of them satisfy all constraints.
        mismatches: how many of them the two forms disagree on.
    """

    draws: int
    inside: int
    mismatches: int


def check_inequality(problems: GraspForceProblem, seed: int) -> InequalityCheck:
    """Random forces around feasible ones of real grasps: inside, across the edge and far off.

    Args:
        problems: one batch dimension, padded contacts allowed.
        seed: of the draws.
    """
    rng = np.random.default_rng(seed)
    draws = inside = mismatches = 0
    for index in range(len(problems)):
        problem = problems[index].without_padding()
        # half the friction and a little preload: feasible forces off the edge, where they exist
        wanted = problem.replace(
            friction=0.5 * problem.friction, normal_min=0.1 + problem.normal_min
        )
        answer = solve(wanted, "clarabel")
        inner = answer.forces if answer.status == "optimal" else solve(problem, "clarabel").forces
        noise = rng.standard_normal((len(_STEPS), _DRAWS_A_STEP, len(inner)))
        forces = (inner + np.array(_STEPS)[:, None, None] * noise).reshape(-1, len(inner))
        excess = np.array(
            [
                max(
                    float(m(problem, f))
                    for m in (friction_violation, normal_violation, torque_violation)
                )
                for f in forces
            ]
        )
        least = np.linalg.eigvalsh(linear_matrix_inequality(problem)(forces))[:, 0]
        clear = (excess > NEAR_THE_EDGE) | (np.abs(least) > NEAR_THE_EDGE)
        allowed = excess <= NEAR_THE_EDGE
        draws += int(clear.sum())
        inside += int((allowed & clear).sum())
        mismatches += int(((least >= -NEAR_THE_EDGE) != allowed)[clear].sum())
    return InequalityCheck(draws, inside, mismatches)


def field_difference(seed: int, programs: int = 200) -> float:
    """Largest relative difference of `kkt_field` from phi as the paper writes it, on random LPs."""
    generator = torch.Generator().manual_seed(seed)
    worst = 0.0
    for _ in range(programs):
        m, k = (int(torch.randint(1, 10, (), generator=generator)) for _ in range(2))
        a, b, d, x, u = (
            torch.randn(*shape, generator=generator, dtype=torch.float64)
            for shape in ((k, m), (k,), (m,), (m,), (k,))
        )
        zero = torch.zeros(m, m, dtype=torch.float64)
        dx, du = kkt_field(ConeProgram(zero, d, a, b, Cone(nonnegative=k)), x, u)
        positive = torch.clamp(u + a @ x - b, min=0.0)
        phi = torch.cat([-(d + a.T @ positive), positive - u])
        difference = torch.linalg.vector_norm(torch.cat([dx, du]) - phi)
        worst = max(worst, float(difference / torch.linalg.vector_norm(phi)))
    return worst
