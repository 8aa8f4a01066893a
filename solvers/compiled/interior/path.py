"""The central path: a homogeneous embedding followed by predictor and corrector.

The embedding of Goulart and Chen ("Clarabel: An interior-point solver for conic programs with
quadratic objectives", 2024) has a point for every problem: a solution over tau where there is one,
a Farkas vector with tau = 0 where there is none. Once it is decided, tau is fixed.
"""

import numpy as np
from numba import njit

from ..constants import MIN_MAX_NORMAL, MIN_NORM, SUM_NORMAL
from .check import PROOF, farkas
from .form import INLINE, OPTIONS, Form
from .kkt import System, factorise
from .state import Goal, Path, residuals, start
from .step import advance

ITERATIONS = 60
"""Most problems take 8 to 15."""

_PATIENCE = 6
"""Iterations without progress before giving up."""

_EXHAUSTED = 1e-15
"""Complementarity at which an embedding that is still undecided has nowhere to go."""

_UNDECIDED = 0.01
"""Where kappa is more than this share of tau a proof is looked for."""

ACCURACY = 1e-11
"""Violation of the constraints, relative to the force scale, at which a path ends; stationarity and
gap may be ten times worse."""

ENOUGH = 1e-8
"""The same, where a path that comes no further still counts as one with a solution."""

_DECIDED = 1e-6
"""The same, from where on tau is fixed: its own step loses digits as the gap closes."""

SOLVED, UNBOUNDED_DUAL, STUCK = 0, 1, 2


@njit(**OPTIONS)
def follow(form: Form, system: System, path: Path, objective: int) -> int:
    """Follow the path to its end: `best_x`, `best_y` in the units of the form, and what they are.

    Returns:
        SOLVED with a solution, UNBOUNDED_DUAL with a Farkas vector (which may still lack the
        accuracy of a proof), or STUCK with the best point on the way.
    """
    goal = Goal(
        1.0 if objective == MIN_NORM else 0.0,
        1.0 if objective == SUM_NORMAL else 0.0,
        1.0 if objective == MIN_MAX_NORMAL else 0.0,
    )
    start(form, path)
    path.best_x[:] = 0.0
    path.best_y[:] = 0.0
    best = np.inf
    waited = 0
    embedded = True
    for _ in range(ITERATIONS):
        here = residuals(form, path, goal)
        tau, kappa = path.extra[1], path.extra[2]
        merit = max(here.primal, 0.1 * max(here.dual, here.gap))
        if not np.isfinite(here.product):
            break
        if here.value < 0.0 and kappa > _UNDECIDED * tau and farkas(form, path.y) > PROOF:
            _keep(path, 1.0)
            return UNBOUNDED_DUAL
        # within the embedding a point may grow worse for long, on its way to a proof
        waited += 0 if embedded and here.product > _EXHAUSTED else 1
        if merit < best:
            waited = 0 if merit < 0.5 * best else waited
            best = merit
            _keep(path, tau)
        if best <= ACCURACY:
            return SOLVED
        if waited > _PATIENCE:
            break
        if embedded and merit < _DECIDED:
            embedded = False
            _fix_tau(form, path)
            here = residuals(form, path, goal)
        if not factorise(form, system, goal.quadratic, path.s, path.z, path.sc, path.zc):
            break
        advance(form, system, path, goal, here, embedded)
    return SOLVED if best <= ENOUGH else STUCK


@njit(**INLINE)
def _fix_tau(form: Form, path: Path) -> None:
    """Divide the state by tau: from here the problem itself is solved, without its embedding."""
    tau = path.extra[1]
    for i in range(form.counts[0]):
        for c in range(3):
            path.x[i, c] /= tau
            path.sc[i, c] /= tau
            path.zc[i, c] /= tau
    for k in range(6 + form.counts[1]):
        path.y[k] /= tau
    for j in range(form.counts[2]):
        path.s[j] /= tau
        path.z[j] /= tau
    path.extra[0] /= tau
    path.extra[1], path.extra[2] = 1.0, 0.0


@njit(**INLINE)
def _keep(path: Path, tau: float) -> None:
    """The state over tau is the best so far."""
    for k in range(len(path.y)):
        path.best_y[k] = path.y[k] / tau
    for i in range(len(path.x)):
        for c in range(3):
            path.best_x[i, c] = path.x[i, c] / tau
