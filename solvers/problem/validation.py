"""The rules that the data of a grasp force problem must keep, each with its error message."""

from functools import reduce
from typing import Any

import numpy as np
from array_api_compat import array_namespace, is_torch_array

from solvers.exceptions import ProblemError

from .fields import (
    ARRAY_FIELDS,
    CORE_NDIM,
    QUALITY_FIELDS,
    WRENCH_SIZE,
    ProblemFields,
    core_shapes,
)
from .scaling import balance_rows

RANK_TOLERANCE = 3e-8
"""A grasp map whose singular values (torque rows over its moment arm) fall below this ratio of the
largest has no full rank, since G G' must have an inverse in float64; ten units in the last place
where that is more (float32)."""

LARGEST = 1e30
"""In the units of each field: with no finite number beyond it are forces, prices and their squares
numbers, whatever the units."""

SMALLEST = 1e-100
"""What is not zero, but smaller, would be zero when squared, and hold no longer what it says."""

_SMALLEST_GRASP_MAP = 1e-30
"""Of the largest entry of its force and of its torque rows: forces are loads over it."""

_MAY_BE_INFINITE = ("torque_min", "torque_max", "normal_max")
_GIVEN = ("friction", *_MAY_BE_INFINITE, "normal_min", *QUALITY_FIELDS)
"""Fields whose every entry counts; of the others, computed by sums that leave tiny remainders, the
largest entry does."""


def as_arrays(values: dict[str, Any]) -> dict[str, Any]:
    """The given fields as arrays of one kind and one floating data type; None is left out.

    They are copies, which the caller cannot change afterwards; those of numpy cannot be written to
    at all, and those of torch stay in its graph of gradients.
    """
    given = {name: value for name, value in values.items() if value is not None}
    torch_names = [name for name, value in given.items() if is_torch_array(value)]
    if torch_names and len(torch_names) < len(given):
        other = next(name for name in given if name not in torch_names)
        raise ProblemError(
            f"{torch_names[0]} is a torch tensor but {other} is not: pass all fields in one kind"
        )
    return _tensors(given) if torch_names else _numpy_arrays(given)


def _numpy_arrays(given: dict[str, Any]) -> dict[str, Any]:
    """All fields but the mask in one data type: float32 if every float is, else float64."""
    arrays = {}
    for name, value in given.items():
        try:
            arrays[name] = np.asarray(value)
        except (ValueError, TypeError, RuntimeError) as error:
            raise ProblemError(f"{name} is not a rectangular array of numbers") from error
        if arrays[name].dtype.kind not in "biuf":
            raise ProblemError(
                f"{name} has the data type {arrays[name].dtype}; it must hold numbers"
            )
        if name == "contact_mask":
            _check_mask(arrays[name])
    sizes = [array.dtype.itemsize for array in arrays.values() if array.dtype.kind == "f"]
    common = np.float32 if sizes and max(sizes) <= 4 else np.float64
    copies = {
        # compiled code takes the copy itself, which may be written to, for the view of it
        name: np.array(array, dtype=bool if name == "contact_mask" else common).view()
        for name, array in arrays.items()
    }
    for view in copies.values():
        view.flags.writeable = False
    return copies


def _tensors(given: dict[str, Any]) -> dict[str, Any]:
    """The same for torch, which is loaded already where there are tensors."""
    import torch

    for name, value in given.items():
        if value.is_complex():
            raise ProblemError(f"{name} has the data type {value.dtype}; it must hold real numbers")
        if name == "contact_mask":
            _check_mask(value)
    devices = {value.device for value in given.values()}
    if len(devices) > 1:
        raise ProblemError(
            f"the tensors lie on {' and '.join(sorted(map(str, devices)))}: bring all to one device"
        )
    kinds = [value.dtype for value in given.values() if value.is_floating_point()]
    common = reduce(torch.promote_types, kinds, torch.float32) if kinds else torch.float64
    return {
        name: value.to(torch.bool if name == "contact_mask" else common, copy=True)
        for name, value in given.items()
    }


def _check_mask(mask: Any) -> None:
    """Refuse what would become True by conversion: a NaN, or a fraction."""
    if not bool(((mask == 0) | (mask == 1)).all()):
        raise ProblemError("contact_mask must hold True and False, or 1 and 0, and nothing else")


def with_defaults(arrays: dict[str, Any], *, for_quality: bool) -> dict[str, Any]:
    """The fields with those that may be absent filled in; those of quality only where wanted."""
    for name in ("grasp_map", "hand_jacobian", "friction", "torque_min"):
        if name not in arrays or arrays[name].ndim < CORE_NDIM[name]:
            raise ProblemError(
                f"{name} needs at least {CORE_NDIM[name]} dimension(s) of numbers; see the shapes "
                "in the docstring of GraspForceProblem"
            )
    xp = array_namespace(arrays["grasp_map"])
    friction, limits = arrays["friction"], arrays["torque_min"]
    defaults = {
        "external_torque": lambda: xp.zeros_like(limits),
        "normal_min": lambda: xp.zeros_like(friction),
        "normal_max": lambda: xp.full_like(friction, xp.inf),
        "contact_mask": lambda: xp.ones_like(friction, dtype=xp.bool),
    }
    if for_quality:
        defaults["effort_weight"] = lambda: xp.zeros_like(friction[..., 0])
        for name in ("effort_budget", "characteristic_length"):
            if name not in arrays:
                raise ProblemError(f"{name} is missing; the objective max_quality needs it")
    else:
        for name in QUALITY_FIELDS:
            if name in arrays:
                raise ProblemError(
                    f"{name} belongs to the objective max_quality; choose that, or leave it out"
                )
    return {
        name: arrays[name] if name in arrays else defaults[name]()
        for name in ARRAY_FIELDS + QUALITY_FIELDS
        if name in arrays or name in defaults
    }


def broadcast(arrays: dict[str, Any]) -> dict[str, Any]:
    """The fields, their core dimensions checked, in one common batch shape."""
    missing = [name for name in ARRAY_FIELDS if name not in arrays]
    if missing:
        raise ProblemError(f"{missing[0]} is missing")
    xp = array_namespace(arrays["grasp_map"])
    n, n_tau = arrays["friction"].shape[-1], arrays["torque_min"].shape[-1]
    if n == 0:
        raise ProblemError("friction is empty: a grasp needs at least one contact")
    core = core_shapes(n, n_tau)
    for name, array in arrays.items():
        got = tuple(array.shape)
        if array.ndim < len(core[name]) or got[array.ndim - len(core[name]) :] != core[name]:
            raise ProblemError(
                f"{name} has shape {got} but its last dimensions must be {core[name]} "
                f"for {n} contacts (from friction) and {n_tau} joints (from torque_min)"
            )
    batches = {name: tuple(a.shape[: a.ndim - len(core[name])]) for name, a in arrays.items()}
    try:
        batch = np.broadcast_shapes(*batches.values())
    except ValueError as error:
        raise ProblemError(f"the batch dimensions do not broadcast: {batches}") from error
    return {name: xp.broadcast_to(a, (*batch, *core[name])) for name, a in arrays.items()}


def check_values(problem: ProblemFields) -> None:
    """Raise a `ProblemError` for the first value that no solver can use."""
    xp = problem.xp
    for name in ARRAY_FIELDS + QUALITY_FIELDS:
        array = getattr(problem, name)
        if name != "contact_mask" and array is not None:
            _check_numbers(problem, name, array)
    mask = problem.contact_mask
    checks: list[tuple[Any, str]] = [
        (problem.friction < 0, "friction is negative; a coefficient of friction is >= 0"),
        (problem.normal_min < 0, "normal_min is negative; contacts push and never pull"),
        (
            (problem.normal_min > problem.normal_max) & mask,
            "normal_min exceeds normal_max at a contact; lower the preload or raise the cap",
        ),
        (
            problem.torque_min > problem.torque_max,
            "torque_min exceeds torque_max at a joint; swap or widen the limits",
        ),
        (
            (problem.torque_min == xp.inf) | (problem.torque_max == -xp.inf),
            "torque_min is inf or torque_max is -inf at a joint; no limit is -inf and inf",
        ),
        (
            ~xp.any(mask, axis=-1),
            "contact_mask is False everywhere in a problem; a grasp needs at least one contact",
        ),
    ]
    if problem.effort_budget is not None:
        checks += [
            (problem.effort_budget <= 0, "effort_budget is not positive; it is in newtons"),
            (
                problem.characteristic_length <= 0,
                "characteristic_length is not positive; take the object's largest radius, in m",
            ),
            (problem.effort_weight < 0, "effort_weight is negative; effort is never worth more"),
        ]
    for bad, message in checks:
        if bool(xp.any(bad)):
            raise ProblemError(f"{message}{_where(problem, bad)}")
    padding = xp.repeat(~mask, 3, axis=-1)
    nonzero = ((problem.grasp_map != 0) & padding[..., None, :]).any(-2) | (
        (problem.hand_jacobian != 0) & padding[..., None]
    ).any(-1)
    if bool(xp.any(nonzero)):
        raise ProblemError(
            "a contact that contact_mask marks as padding has nonzero columns in grasp_map or rows "
            f"in hand_jacobian{_where(problem, nonzero)}; set them to zero or unmask the contact"
        )
    singular = xp.linalg.svdvals(balance_rows(xp, _in_double(problem.grasp_map)))
    tolerance = max(RANK_TOLERANCE, 10 * xp.finfo(problem.grasp_map.dtype).eps)
    rank = xp.sum(singular > tolerance * singular[..., :1], axis=-1)
    deficient = rank < WRENCH_SIZE
    if bool(xp.any(deficient)):
        raise ProblemError(
            f"grasp_map has rank {int(xp.min(rank))} and not 6{_where(problem, deficient)}: some "
            "wrench cannot be applied at all (fewer than three contacts, or all on one line); "
            "add a contact"
        )


def _check_numbers(problem: ProblemFields, name: str, array: Any) -> None:
    """Refuse NaN, infinity where it means nothing, and what is too large or too small to square."""
    xp = problem.xp
    size = xp.abs(array)
    fine = size <= LARGEST
    if name in _MAY_BE_INFINITE:
        fine = fine | (size == xp.inf)
    if not bool(xp.all(fine)):
        nan = xp.isnan(array)
        if bool(xp.any(nan)):
            raise ProblemError(
                f"{name} contains NaN{_where(problem, nan)}: check the contacts behind it"
            )
        infinite = size == xp.inf
        if name not in _MAY_BE_INFINITE and bool(xp.any(infinite)):
            raise ProblemError(
                f"{name} contains an infinite value{_where(problem, infinite)}; it must be finite"
            )
        no_limit = "; no limit is inf" if name in _MAY_BE_INFINITE else ""
        raise ProblemError(
            f"{name} has an entry beyond {LARGEST:g} in size{_where(problem, ~fine)}, which cannot "
            f"be computed with: choose other units{no_limit}"
        )
    core = tuple(range(-CORE_NDIM[name], 0))
    if name == "grasp_map":
        for rows, what in ((size[..., :3, :], "force"), (size[..., 3:, :], "torque")):
            tiny = xp.all(rows < _SMALLEST_GRASP_MAP, axis=core) & xp.any(rows > 0, axis=core)
            if bool(xp.any(tiny)):
                raise ProblemError(
                    f"grasp_map has {what} rows{_where(problem, tiny)} without any entry of "
                    f"{_SMALLEST_GRASP_MAP:g} or more in size, which cannot be computed with: "
                    "choose other units"
                )
        return
    tiny = (size > 0) & (size < SMALLEST)
    if name not in _GIVEN:
        tiny = xp.any(tiny, axis=core) & ~xp.any(size >= SMALLEST, axis=core)
    if bool(xp.any(tiny)):
        raise ProblemError(
            f"{name} is smaller than {SMALLEST:g} in size{_where(problem, tiny)}, but not zero, "
            "which cannot be computed with: choose other units, or set it to zero"
        )


def _in_double(array: Any) -> Any:
    """The array in float64, in which its squares are numbers."""
    if not is_torch_array(array):
        return np.asarray(array, dtype=np.float64)
    # some devices know no float64
    return array.detach().to("cpu" if array.device.type == "mps" else array.device).double()


def _where(problem: ProblemFields, bad: Any) -> str:
    """' (batch index ...)' of the first bad entry, or '' for a single problem."""
    if not problem.batch_shape:
        return ""
    host = bad.detach().cpu().numpy() if is_torch_array(bad) else np.asarray(bad)
    first = np.argwhere(host)[0][: len(problem.batch_shape)]
    return f" (batch index {', '.join(str(int(i)) for i in first)})"
