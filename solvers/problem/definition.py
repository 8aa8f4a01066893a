"""The grasp force problem: data, validation, batching and storage."""

import dataclasses
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from numbers import Integral
from pathlib import Path
from typing import Any, Self

import numpy as np
from array_api_compat import is_torch_array

from solvers.arguments import check_shape, plain
from solvers.arrays import Array
from solvers.exceptions import ProblemError, UnreadableFileError
from solvers.files import read_arrays, write_arrays

from .fields import ARRAY_FIELDS, CORE_NDIM, QUALITY_FIELDS, ProblemFields, core_shapes
from .validation import as_arrays, broadcast, check_values, with_defaults

OBJECTIVES = ("min_norm", "sum_normal", "min_max_normal")
"""Names of the objectives: half the squared norm of the forces, the sum of normal forces, or the
largest normal force (Boyd and Wegbreit, "Fast computation of optimal contact forces", 2007).
These are convex."""

MAX_QUALITY = "max_quality"
"""The objective that is not convex: the most quality q_lrw for the effort."""

_FORMAT = "graspforce-problem-1"

_KINDS = {name: np.dtype(bool if name == "contact_mask" else np.float64) for name in ARRAY_FIELDS}


@dataclass(frozen=True, eq=False, kw_only=True)
class GraspForceProblem(ProblemFields):
    """Contact forces that balance a load, inside friction cones and torque limits.

    minimise   1/2 |f|^2  (`min_norm`)  or  sum_i f_n,i  (`sum_normal`)
               or  max_i f_n,i  (`min_max_normal`)
               or  effort_weight sum_i f_n,i - q_lrw(f_n)  (`max_quality`)
    subject to G f = -w,
               |f_t,i| <= mu_i f_n,i,   normal_min_i <= f_n,i <= normal_max_i,
               torque_min <= J_h' f + tau_ext <= torque_max,
               sum_i f_n,i <= effort_budget  (`max_quality`).

    The forces of contact i are f_i = (f_t1, f_t2, f_n) in its contact frame (t1, t2, n), n the
    inward normal, right-handed. Wrenches are [force; torque about the object's centre of mass].
    Every array may carry leading batch dimensions, which broadcast against each other; all arrays
    are numpy arrays, or all are torch tensors of one device. The problem keeps copies of them:
    numpy's cannot be written to, torch's are in the graph of gradients. The model is that of
    Basumatary et al., "Grasp Force Optimization as a Bilinear Matrix Inequality Problem", section
    4.2, with preload and cap added.

    Numbers are at most 1e30 in size, or infinite where a limit may be, so that squares and products
    are numbers, too. Limits, preloads, friction and the fields of quality are zero or at least
    1e-100, and so is the largest entry of J_h, of w and of tau_ext; that of the force rows and that
    of the torque rows of G is at least 1e-30.

    Args:
        grasp_map: (..., 6, 3n) G, contact forces to object wrench; moment arms in m.
        hand_jacobian: (..., 3n, n_tau) J_h; joint torques are J_h' f + tau_ext; m.
        friction: (..., n) mu >= 0; zero is a frictionless contact.
        torque_min: (..., n_tau) lower torque limits, N·m; -inf where there is none.
        torque_max: (..., n_tau) upper torque limits, N·m; inf where there is none.
        external_wrench: (..., 6) w, the load on the object: N, N·m.
        external_torque: (..., n_tau) joint torques needed without any contact force, N·m. Default
            0.
        normal_min: (..., n) preload, the least normal force, N. Default 0.
        normal_max: (..., n) cap, the largest normal force, N. Default inf.
        contact_mask: (..., n) False at padding contacts, whose columns of G and rows of J_h are
            zero.
        objective: one of `OBJECTIVES`, or `MAX_QUALITY`. The fields below belong to the latter
            alone, whose q_lrw (see `gfo_env.contacts.quality`) is that of round cones.
        effort_budget: (...,) N > 0, the largest sum of normal forces.
        characteristic_length: (...,) m > 0, that q_lrw divides torques by: the object's largest
            radius about its centre of mass.
        effort_weight: (...,) >= 0, newtons of q_lrw that a newton of effort is worth. Default 0.

    Raises:
        ProblemError: for a wrong shape, a NaN, numbers too large or too small, crossed bounds,
            negative friction or preload, padding that is not zero, or a grasp map of rank below 6.
    """

    def __post_init__(self) -> None:
        if not isinstance(self.objective, str) or self.objective not in (*OBJECTIVES, MAX_QUALITY):
            raise ProblemError(
                f"objective {self.objective!r} is unknown; choose one of "
                f"{', '.join((*OBJECTIVES, MAX_QUALITY))}"
            )
        for_quality = self.objective == MAX_QUALITY
        names = ARRAY_FIELDS + QUALITY_FIELDS
        arrays = as_arrays({name: getattr(self, name) for name in names})
        arrays = with_defaults(arrays, for_quality=for_quality)
        arrays = broadcast(arrays)
        for name, array in arrays.items():
            object.__setattr__(self, name, array)
        check_values(self)

    def replace(self, **changes: Any) -> Self:
        """A copy with some fields replaced, validated like a new problem."""
        return dataclasses.replace(self, **changes)

    def __len__(self) -> int:
        if not self.batch_shape:
            raise TypeError("a single GraspForceProblem has no length; only a batch has one")
        return self.batch_shape[0]

    def __getitem__(self, index: Any) -> Self:
        """The problems at `index` of the batch dimensions (numpy indexing)."""
        if not self.batch_shape:
            raise TypeError("a single GraspForceProblem cannot be indexed; only a batch can")
        # whole core dimensions, spelt out, so that too many indices are an error and no slice of G
        batch = index if isinstance(index, tuple) else (index,)
        return self.derived(
            **{
                name: array[(*batch, *[slice(None)] * CORE_NDIM[name])]
                for name, array in self._arrays().items()
            }
        )

    def reshape(self, *batch_shape: int) -> Self:
        """The same problems with other batch dimensions; `reshape(-1)` flattens them."""
        # a broadcast array without memory, to resolve -1 where a core dimension may be zero
        wanted = np.broadcast_to(0, self.batch_shape).reshape(batch_shape).shape
        return self.derived(
            **{
                name: self.xp.reshape(
                    array, (*wanted, *array.shape[array.ndim - CORE_NDIM[name] :])
                )
                for name, array in self._arrays().items()
            }
        )

    def to_numpy(self) -> Self:
        """The same problems as float64 numpy arrays: the form in which answers are judged."""

        def convert(array: Any) -> np.ndarray:
            host = array.detach().cpu().numpy() if is_torch_array(array) else np.asarray(array)
            return host if host.dtype == bool else host.astype(np.float64)

        return self._map(convert)

    def flat(self) -> Self:
        """The same problems as contiguous float64 numpy arrays with exactly one batch dimension.

        The arrays are writable, because numba compiles anew for those that are not.
        """
        batch = self.batch_shape
        count = math.prod(batch)
        host = self if isinstance(self.grasp_map, np.ndarray) else self.to_numpy()
        arrays = {}
        for name, array in host._arrays().items():
            kind = bool if name == "contact_mask" else np.float64
            one = array.reshape((count, *array.shape[len(batch) :]))
            arrays[name] = np.array(one, dtype=kind, order="C")
        return self.unchecked(arrays, self.objective)

    def to_torch(self, *, dtype: Any = None, device: Any = None) -> Self:
        """The same problems as torch tensors (default: float64 on the CPU)."""
        import torch

        def convert(array: Any) -> Any:
            # a copy: torch refuses to share memory that numpy protects against writing
            tensor = array if is_torch_array(array) else torch.tensor(np.array(array))
            wanted = torch.bool if tensor.dtype == torch.bool else (dtype or torch.float64)
            return tensor.to(device=device, dtype=wanted)

        return self._map(convert)

    @classmethod
    def stack(cls, problems: Sequence["GraspForceProblem"]) -> "GraspForceProblem":
        """One batch from problems of one batch shape, padded to the largest number of contacts.

        Raises:
            ProblemError: if there are none, if some are no problems, or if they differ in joints,
                objective, batch dimensions or kind of array.
        """
        if isinstance(problems, GraspForceProblem) or not isinstance(problems, Iterable):
            raise ProblemError("a sequence of problems must be given, to make one batch of them")
        problems = [as_problem(problem) for problem in problems]
        if not problems:
            raise ProblemError("there is nothing to stack: pass at least one problem")
        if len({(p.n_joints, p.objective, p.batch_shape, type(p.grasp_map)) for p in problems}) > 1:
            raise ProblemError(
                "stacked problems must share the number of joints, the objective, the batch "
                "dimensions and the kind of array"
            )
        width = max(p.n_contacts for p in problems)
        padded = [p.pad(width)._arrays() for p in problems]
        xp = problems[0].xp
        arrays = {name: xp.stack([arrays[name] for arrays in padded]) for name in padded[0]}
        return cls.unchecked(arrays, problems[0].objective)

    def pad(self, n_contacts: int) -> Self:
        """The same problems with masked contacts appended, up to `n_contacts`."""
        if isinstance(n_contacts, bool) or not isinstance(n_contacts, Integral):
            raise ProblemError(f"contacts come in whole numbers, not {n_contacts!r}")
        extra = int(n_contacts) - self.n_contacts
        if extra < 0:
            raise ProblemError(f"{self.n_contacts} contacts cannot be padded to {n_contacts}")
        if extra == 0:
            return self
        xp = self.xp

        def append(array: Any, axis: int, count: int, value: Any) -> Any:
            shape = list(array.shape)
            shape[axis] = count
            block = xp.broadcast_to(xp.asarray(value, dtype=array.dtype), tuple(shape))
            if is_torch_array(array):
                block = block.to(array.device)
            return xp.concat([array, block], axis=axis)

        arrays = self._arrays()
        arrays["grasp_map"] = append(self.grasp_map, -1, 3 * extra, 0.0)
        arrays["hand_jacobian"] = append(self.hand_jacobian, -2, 3 * extra, 0.0)
        for name, value in (("friction", 0.0), ("normal_min", 0.0), ("normal_max", np.inf)):
            arrays[name] = append(arrays[name], -1, extra, value)
        arrays["contact_mask"] = append(self.contact_mask, -1, extra, False)
        return self.derived(**arrays)

    def without_padding(self) -> Self:
        """A single problem with its padding contacts removed."""
        if self.batch_shape:
            raise TypeError("only a single problem can drop its padding; index the batch first")
        mask = self.contact_mask
        columns = self.xp.repeat(mask, 3)
        arrays = self._arrays()
        arrays["grasp_map"] = self.grasp_map[:, columns]
        arrays["hand_jacobian"] = self.hand_jacobian[columns, :]
        for name in ("friction", "normal_min", "normal_max", "contact_mask"):
            arrays[name] = arrays[name][mask]
        return self.derived(**arrays)

    def save(self, path: str | Path) -> None:
        """Write the problems to `path` as an uncompressed .npz archive of float64 arrays.

        Raises:
            UnwritableFileError: if the system refuses; what lay there before still does.
        """
        arrays = self.to_numpy()._arrays()
        header = json.dumps({"format": _FORMAT, "objective": self.objective})
        write_arrays(Path(path), {"header": np.array(header), **arrays})

    @classmethod
    def load(cls, path: str | Path) -> "GraspForceProblem":
        """Read what `save` wrote, and validate it again.

        Raises:
            ProblemError: if the file is missing, is not such an archive, or holds bad problems.
        """
        try:
            found = read_arrays(Path(path))
            header = json.loads(str(found["header"]))
            version, objective = header["format"], header["objective"]
            names = ARRAY_FIELDS + QUALITY_FIELDS * (objective == MAX_QUALITY)
            arrays = {name: found[name] for name in names if version == _FORMAT}
        except FileNotFoundError as error:
            raise ProblemError(f"no problem file at {path}") from error
        # the last three: a header that is none, and arrays that are missing
        except (UnreadableFileError, KeyError, TypeError, ValueError, RecursionError) as error:
            raise ProblemError(
                f"{path} is not a problem file: write it with GraspForceProblem.save"
            ) from error
        if version != _FORMAT:
            raise ProblemError(f"{path} has the format {version!r}, not {_FORMAT!r}")
        return cls(**arrays, objective=objective)

    def plain_arrays(self, dimensions: int) -> tuple[Array, ...]:
        """The array fields of every objective as compiled code takes them.

        Float64 (bool for the mask), C-contiguous and writable; copies where the fields are not.
        Compiled code trusts their shapes, so those of problems that were not validated are looked
        at here.

        Args:
            dimensions: of the batch that the code takes, 0 or 1.

        Raises:
            ProblemError: for tensors, another number of batch dimensions, or an array whose shape
                is not that of the problem's batch, contacts and joints.
        """
        batch = self.batch_shape
        if len(batch) != dimensions:
            wanted = "one problem" if dimensions == 0 else "problems with one batch dimension"
            raise ProblemError(f"{wanted} must be given, not a batch of shape {batch}")
        core = core_shapes(self.n_contacts, self.n_joints)
        arrays = []
        for name in ARRAY_FIELDS:
            array = getattr(self, name)
            if not isinstance(array, np.ndarray):
                raise ProblemError(f"{name} must be a numpy array: call problem.to_numpy() first")
            check_shape(name, array, batch + core[name])
            arrays.append(plain(array, _KINDS[name]))
        return tuple(arrays)

    def constraints(self, objective: str = "min_norm") -> Self:
        """The convex problem of the same constraints, but for the budget of effort."""
        arrays = {name: getattr(self, name) for name in ARRAY_FIELDS}
        return self.unchecked(arrays, objective)

    def arrays(self) -> tuple[Any, ...]:
        """The array fields of every objective, in the order of the class."""
        return tuple(getattr(self, name) for name in ARRAY_FIELDS)

    def _arrays(self) -> dict[str, Any]:
        names = ARRAY_FIELDS + QUALITY_FIELDS * (self.objective == MAX_QUALITY)
        return {name: getattr(self, name) for name in names}

    def _map(self, function: Any) -> Self:
        return self.derived(**{name: function(array) for name, array in self._arrays().items()})

    def derived(self, **arrays: Any) -> Self:
        """A copy with some arrays replaced, not validated: see `unchecked`; `replace` validates."""
        return self.unchecked({**self._arrays(), **arrays}, self.objective)

    @classmethod
    def unchecked(cls, arrays: Mapping[str, Any], objective: str = "min_norm") -> Self:
        """A problem of arrays that are valid by construction: none is checked, none filled in.

        Canonical forms, tightened problems and slices are made by the million, and an environment's
        problems at every step; whoever has data from elsewhere makes a `GraspForceProblem(...)`.

        Args:
            arrays: every array field that the objective has, with all batch dimensions.
            objective: see the class.
        """
        problem = object.__new__(cls)
        for name, array in arrays.items():
            object.__setattr__(problem, name, array)
        object.__setattr__(problem, "objective", objective)
        return problem


def as_problem(value: Any) -> GraspForceProblem:
    """The value, if it is a problem.

    Raises:
        ProblemError: otherwise.
    """
    if isinstance(value, GraspForceProblem):
        return value
    raise ProblemError(
        f"a GraspForceProblem must be given, not {type(value).__name__}: make one of the arrays of "
        "a grasp, GraspForceProblem(grasp_map=..., ...)"
    )
