"""Can survival of a shake be foretold without simulating? Margins against outcomes.

The `margin` of forces, a number without unit, is certified, and the worst of the loads counts:
- negative, if they provably cannot carry a load: minus the share of them that stays unbalanced, the
  least acceleration with which the object must start to move (`training.studies.holding.margins`)
  times its mass over the size of the forces;
- else the friction that the contact with the least of it has to spare, over the size of the forces.
"""

import numpy as np
from rich.progress import Progress

from gfo_env.workers import bar
from solvers import GraspForceProblem
from solvers.arrays import Array
from solvers.problem import residuals
from training.reports.intervals import object_interval

from .margins import predicted_acceleration, roc_area
from .rates import NOISE_LEVELS, ORACLE, HoldPlan, Outcomes, Row, hold_problems

FEASIBLE = (ORACLE, "no_preload")
"""Methods whose forces satisfy every constraint of every load."""

POOLED = (
    *FEASIBLE,
    "weight_only",
    *(f"noise_{level:.0%}" for level in NOISE_LEVELS),
    "equal_squeeze",
    "equal_squeeze_same_effort",
    "random_in_cone_same_effort",
)
"""Methods whose outcomes are foretold together; no force at all would be too easy, and the network
is too like the oracle."""

_LEAST_EFFORT = 1e-9


def roc_rows(plan: HoldPlan, outcomes: Outcomes, progress: Progress | None = None) -> list[Row]:
    """ROC areas against survival, one row a predictor: pooled, and of feasible forces alone.

    Args:
        plan: of the outcomes.
        outcomes: of `judge_holding`.
        progress: a bar is added to it.
    """
    scores, error = predictors(plan, outcomes, progress)
    count = len(outcomes.tasks)
    held = np.concatenate([outcomes.held[name] for name in POOLED])
    owners = np.tile(outcomes.table.object_id, len(POOLED))
    rows: list[Row] = []
    for name, score in scores.items():
        row: Row = {"predictor": name}
        pairs = np.stack([score, held], axis=1)
        for key, end in (("roc_area", len(held)), ("roc_area_feasible", len(FEASIBLE) * count)):
            row[key] = _area(pairs[:end])
            row[f"{key}_ci"] = list(object_interval(pairs[:end], owners[:end], _area))
        row["certified_error_max"] = error if name == "acceleration" else None
        rows.append(row)
    return rows


def predictors(
    plan: HoldPlan, outcomes: Outcomes, progress: Progress | None = None
) -> tuple[dict[str, Array], float]:
    """(methods * grasps) scores, the higher the likelier to hold, and the accelerations' error.

    Methods are those of `POOLED`, one after the other; of the loads, the worst counts. The error is
    the largest certified one, in m/s2.
    """
    problems = hold_problems(plan, outcomes.table, outcomes.tasks, 0.0)
    true = problems.replace(friction=problems.friction / plan.friction_factor)
    step = bar(progress, "margins", len(POOLED) * len(outcomes.tasks))
    lengths = np.repeat([[1.0, 1.0]], len(outcomes.tasks), axis=0)
    lengths[:, 1] = outcomes.table.object_radius
    scaled = true.grasp_map[:, 0] / np.repeat(lengths, 3, axis=1)[..., None]
    smallest = np.linalg.svd(scaled, compute_uv=False)[:, -1]
    mass = np.array([task.mass for task in outcomes.tasks])
    columns: dict[str, list[Array]] = {}
    largest = 0.0
    for name in POOLED:
        forces = outcomes.forces[name]
        effort = np.linalg.norm(forces, axis=-1)
        balance = residuals.equilibrium_residual(true, forces) / np.maximum(effort, 1e-9)
        spare = _spare_friction(true, forces)
        accelerations, errors = _accelerations(plan, outcomes, true, forces)
        largest = max(largest, float(errors.max()))
        proven = mass[:, None] * np.maximum(accelerations - errors, 0.0)
        margin = np.where(proven > 0, -proven, np.maximum(spare, 0.0))
        margin /= np.maximum(effort, _LEAST_EFFORT)
        for key, score in {
            "margin": margin.min(axis=1),
            "acceleration": -accelerations.max(axis=1),
            "balance_error": -balance.max(axis=1),
            "spare_friction": spare.min(axis=1),
            "effort": effort.mean(axis=1),
            "smallest_singular_value": smallest,
            "mass": mass,
        }.items():
            columns.setdefault(key, []).append(score)
        step(len(outcomes.tasks))
    return {key: np.concatenate(scores) for key, scores in columns.items()}, largest


def _accelerations(
    plan: HoldPlan, outcomes: Outcomes, problems: GraspForceProblem, forces: Array
) -> tuple[Array, Array]:
    """(grasps, phases) m/s2, and their certified errors."""
    values, errors = np.zeros(forces.shape[:2]), np.zeros(forces.shape[:2])
    for row, task in enumerate(outcomes.tasks):
        body = plan.objects[str(outcomes.table.object_id[row])].with_mass(task.mass)
        inertia = np.zeros((6, 6))
        inertia[:3, :3] = body.mass * np.eye(3)
        inertia[3:, 3:] = body.inertia
        used = np.repeat(outcomes.table.contact_mask[row], 3)
        for phase in range(forces.shape[1]):
            found = predicted_acceleration(
                problems[row, phase].without_padding(),
                forces[row, phase][used],
                inertia,
                body.radius,
                joint_friction=plan.physics.joint_friction,
            )
            values[row, phase], errors[row, phase] = found.value, found.error
    return values, errors


def _spare_friction(problems: GraspForceProblem, forces: Array) -> Array:
    """(grasps, phases) N: the least friction to spare of any contact; negative where it slips."""
    vectors = forces.reshape(*forces.shape[:-1], -1, 3)
    spare = problems.friction * vectors[..., 2] - np.linalg.norm(vectors[..., :2], axis=-1)
    return np.where(problems.contact_mask, spare, np.inf).min(axis=-1)


def _area(pairs: Array) -> float:
    return roc_area(pairs[:, 0], pairs[:, 1] > 0.5)
