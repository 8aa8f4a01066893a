"""The demonstration: grasp unseen meshes, solve for the forces twice, hold the objects, draw it."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from rich.progress import Progress

from gfo_env.conditions import PRELOAD
from gfo_env.contacts import lowest_resisted_wrench
from gfo_env.exceptions import AcquisitionError
from gfo_env.grasps.acquisition import Grasp, Watcher, attempt
from gfo_env.holding import ShakeProtocol, shake
from gfo_env.objects import GraspObject, ObjectSet
from gfo_env.pose import Pose
from gfo_env.simulation import (
    LOAD_COLOUR,
    METRES_PER_NEWTON,
    Camera,
    Simulation,
    draw_forces,
    render,
)
from solvers import GraspForceSolution, Solver
from training.problems.tasks import Task, make_task, pose_problem

PANELS = ("approach", "pre-grasp", "closing", "held, with forces")

_APPROACH = 0.09
_CAMERA = Camera(
    width=340, height=290, eye=(0.33, -0.40, 0.36), target=(0.0, 0.0, 0.125), field_of_view=29.0
)
_CLOSE_UP = replace(_CAMERA, target=(0.0, 0.0, 0.105), field_of_view=22.0)
_TITLE = 26
_CAPTION = 24
_INK = (40, 40, 40)


@dataclass(frozen=True, eq=False)
class Shown:
    """One grasp of the demonstration, with each solver's answer to the loads and its fate.

    Args:
        number: seed of the attempt.
        grasp: acquired.
        grasp_object: as it was grasped; the task says what it weighs when it is carried.
        task: what must be carried.
        solutions: by solver, batches of (phases,).
        quality: by solver, q_lrw (lower bound, N) of the forces that carry the weight.
        held: by solver, whether the object stayed in the hand.
    """

    number: int
    grasp: Grasp
    grasp_object: GraspObject
    task: Task
    solutions: dict[str, GraspForceSolution]
    quality: dict[str, float]
    held: dict[str, bool]


def demonstrate(
    objects: ObjectSet, solvers: dict[str, Solver], count: int, seed: int, progress: Progress
) -> list[Shown]:
    """Grasp `count` objects, each with a load that the first solver can carry.

    Args:
        objects: the unseen meshes.
        solvers: by name; the first is the reference.
        count: how many grasps.
        seed: of everything.
        progress: a bar is added to it.

    Raises:
        AcquisitionError: the number of grasps is not positive, or the seed negative.
    """
    if count < 1 or seed < 0:
        raise AcquisitionError(
            f"grasps must be 1 or more and seed 0 or more, not {count} and {seed}"
        )
    simulation = Simulation()
    protocol = ShakeProtocol()
    reference = next(iter(solvers))
    order = np.random.default_rng(seed).permutation(len(objects))
    bar = progress.add_task("grasping, solving, holding", total=count)
    shown: list[Shown] = []
    for number, place in enumerate(np.tile(order, 4)):
        grasp_object = objects[objects.object_ids[place]]
        result = attempt(grasp_object, simulation, np.random.default_rng([seed, number]))
        if result.grasp is None:
            continue
        grasp = result.grasp
        task = make_task(seed, number)
        body = grasp_object.with_mass(task.mass)
        problem = pose_problem(grasp, task, protocol, PRELOAD)
        solutions = {name: solver.solve(problem) for name, solver in solvers.items()}
        if not np.all(solutions[reference].status == "optimal"):
            continue
        forces = {name: np.nan_to_num(s.forces) for name, s in solutions.items()}
        held = {
            name: shake(simulation, grasp, body, f, task.gravity, friction=task.friction).held
            for name, f in forces.items()
        }
        quality = {name: _quality(grasp, grasp_object, task, f[0]) for name, f in forces.items()}
        shown.append(Shown(number, grasp, grasp_object, task, solutions, quality, held))
        progress.advance(bar)
        if len(shown) == count:
            break
    simulation.close()
    return shown


def draw(shown: list[Shown], solver: str, seed: int, path: Path) -> None:
    """Write a picture of grasps, a row each: approach, pre-grasp, closing, held with the forces.

    Args:
        shown: grasps to draw.
        solver: whose forces are drawn.
        seed: that the grasps were made with.
        path: of the PNG.
    """
    simulation = Simulation(visible=True)
    rows = [_row(simulation, one, solver, seed) for one in shown]
    simulation.close()
    width, height = _CAMERA.width, _CAMERA.height
    sheet = Image.new(
        "RGB", (len(PANELS) * width, _TITLE + len(rows) * (height + _CAPTION)), "white"
    )
    ink = ImageDraw.Draw(sheet)
    title, caption = ImageFont.load_default(17), ImageFont.load_default(14)
    for column, name in enumerate(PANELS):
        ink.text(((column + 0.5) * width, 4), name, fill=_INK, font=title, anchor="mt")
    for index, (one, panels) in enumerate(zip(shown, rows, strict=True)):
        top = _TITLE + index * (height + _CAPTION)
        for column, panel in enumerate(panels):
            sheet.paste(Image.fromarray(panel), (column * width, top))
        ink.text((8, top + height + 2), _describe(one, solver), fill=_INK, font=caption)
    # few colours keep the file small; the default method would drop the thin blue arrows
    sheet.quantize(256, Image.Quantize.MAXCOVERAGE).save(path, format="PNG", optimize=True)


def _quality(grasp: Grasp, grasp_object: GraspObject, task: Task, forces: np.ndarray) -> float:
    contacts = grasp.contacts
    return lowest_resisted_wrench(
        contacts.positions,
        contacts.normals,
        np.full(len(contacts), task.friction),
        normal_forces=np.maximum(forces.reshape(-1, 3)[:, 2], 0.0),
        length=grasp_object.radius,
    ).lower


def _row(simulation: Simulation, one: Shown, solver: str, seed: int) -> list[np.ndarray]:
    """The four pictures of a grasp; the attempt is replayed, twice, because it is deterministic."""
    start: list[tuple[Pose, np.ndarray]] = []
    steps = 0

    def count(phase: str) -> None:
        nonlocal steps
        if phase == "pre-grasp":
            start.append((simulation.object_pose(), simulation.joint_state()[0]))
        steps += phase == "closing"

    _replay(simulation, one, seed, count)
    middle, pictures = steps // 4, []
    pose, angles = start[0]
    raised = Pose(pose.position + np.array([0.0, 0.0, _APPROACH]), pose.rotation)
    simulation.load(one.grasp_object, raised, angles, friction=one.task.friction)
    pictures.append(render(simulation, _CAMERA))
    steps = 0

    def watch(phase: str) -> None:
        nonlocal steps
        steps += phase == "closing"
        if phase == "pre-grasp" or (phase == "closing" and steps == middle):
            pictures.append(render(simulation, _CAMERA))

    _replay(simulation, one, seed, watch)
    task, forces = one.task, one.solutions[solver].forces
    body = one.grasp_object.with_mass(task.mass)
    shake(simulation, one.grasp, body, forces, task.gravity, friction=task.friction)
    held = render(simulation, _CLOSE_UP)
    now, contacts = simulation.object_pose(), one.grasp.contacts
    pressed = np.einsum("nij,nj->ni", contacts.frames, forces[-1].reshape(-1, 3))
    points = now.to_hand(contacts.positions)
    held = draw_forces(held, _CLOSE_UP, points, pressed @ now.rotation.T)
    load = ShakeProtocol().loads(task.mass, task.gravity)[-1:, :3]
    tip = now.position + METRES_PER_NEWTON * load
    pictures.append(draw_forces(held, _CLOSE_UP, tip, load, colour=LOAD_COLOUR))
    return pictures


def _replay(simulation: Simulation, one: Shown, seed: int, watch: Watcher) -> None:
    attempt(one.grasp_object, simulation, np.random.default_rng([seed, one.number]), watch)


def _describe(one: Shown, solver: str) -> str:
    normal = one.solutions[solver].forces.reshape(ShakeProtocol().phases, -1, 3)[-1, :, 2]
    pressed = ", ".join(f"{value:.1f}" for value in normal)
    return (
        f"mesh {one.grasp_object.object_id}: {one.task.mass:.2f} kg, friction "
        f"{one.task.friction:.2f}; normal forces {pressed} N (red); weight and a 2 N push (blue)"
    )
