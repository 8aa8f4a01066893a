"""cvxpylayers, the usual differentiable convex layer; only its forward pass is used."""

from importlib import import_module
from typing import Any

import numpy as np

from .conic import EQUALITIES, ConicBatch
from .peers import Peer, RawAnswer


class CvxpyLayersPeer(Peer):
    """A layer for each number of contacts, with G, J_h, friction and every limit as parameters.

    It raises at an infeasible problem, and is given only problems known to be feasible. Its cones
    have no dual variables that it would hand out; equilibrium and torque limits do, and these are
    all that the dual bound needs.
    """

    title = "cvxpylayers"
    package = "cvxpylayers"
    settings = "forward only, diffcp with Clarabel, one thread, no gradients"
    batched = True
    feasible_only = True

    def __init__(self) -> None:
        self._layers: dict[tuple[int, int], Any] = {}

    def convert(self, part: ConicBatch) -> Any:
        """The layer and its parameters as tensors."""
        import torch

        key = (part.n_contacts, part.n_joints)
        if key not in self._layers:
            self._layers[key] = _layer(*key)
        contact = np.arange(part.n_contacts)
        torque = EQUALITIES + 2 * part.n_joints
        normal = torque + 2 * part.n_contacts
        arrays = (
            part.matrix[:, :EQUALITIES],
            part.bound[:, :EQUALITIES],
            part.matrix[:, EQUALITIES:torque],
            part.bound[:, EQUALITIES:torque],
            part.matrix[:, torque:normal, 2::3],
            part.bound[:, torque:normal],
            -part.matrix[:, normal::3, 2::3][:, contact, contact],
        )
        return self._layers[key], [torch.tensor(array) for array in arrays]

    def solve_part(self, program: Any) -> Any:
        """The layer's variables and duals."""
        import torch

        layer, parameters = program
        with torch.inference_mode():
            return layer(*parameters)

    def read(self, part: ConicBatch, raw: Any) -> RawAnswer:
        """See the base."""
        x, equilibrium, torque = (np.asarray(tensor) for tensor in raw)
        dual = np.zeros(part.bound.shape)
        dual[:, :EQUALITIES] = equilibrium
        dual[:, EQUALITIES : EQUALITIES + 2 * part.n_joints] = torque
        return x, dual


def _layer(contacts: int, joints: int) -> Any:
    import cvxpy as cp
    from cvxpy.atoms.sum_squares import sum_squares

    # by name: the checker knows the package only where it is installed
    layer = import_module("cvxpylayers.torch").CvxpyLayer

    x = cp.Variable(3 * contacts)
    grasp, load = cp.Parameter((EQUALITIES, 3 * contacts)), cp.Parameter(EQUALITIES)
    torque, limit = cp.Parameter((2 * joints, 3 * contacts)), cp.Parameter(2 * joints)
    normal, bound = cp.Parameter((2 * contacts, contacts)), cp.Parameter(2 * contacts)
    friction = cp.Parameter(contacts, nonneg=True)
    balance, limits = grasp @ x == load, torque @ x <= limit
    cones = [cp.SOC(friction[i] * x[3 * i + 2], x[3 * i : 3 * i + 2]) for i in range(contacts)]
    problem = cp.Problem(
        cp.Minimize(0.5 * sum_squares(x)),
        [balance, limits, normal @ x[2::3] <= bound, *cones],
    )
    return layer(
        problem,
        parameters=[grasp, load, torque, limit, normal, bound, friction],
        variables=[x, balance.dual_variables[0], limits.dual_variables[0]],
        solver_args={"solve_method": "Clarabel", "n_jobs_forward": 1},
    )
