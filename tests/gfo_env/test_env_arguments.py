"""What may be passed to the environment and to its reset, and the errors for what may not."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
import trimesh
from gymnasium.error import ResetNeeded

from gfo_env.env import GraspForceEnv
from gfo_env.exceptions import AcquisitionError, EnvironmentSettingsError, ObjectSetError
from gfo_env.mdp.loads import LoadSettings
from gfo_env.mdp.reward import RewardWeights
from gfo_env.policy import SolverPolicy
from solvers import GraspForceError
from tests.support.episodes import assert_same, episode_of, play
from tests.support.seeds import reseeded


@pytest.mark.parametrize(
    ("argument", "value"),
    [
        ("max_contacts", 2),
        ("max_force", 0.0),
        ("max_force", float("inf")),
        ("preload", -1.0),
        ("preload", 30.0),
        ("friction_range", (0.8, 0.4)),
        ("friction_range", (0.0, 0.4)),
        ("mass_range", (0.1, float("nan"))),
        ("push", float("nan")),
        ("horizon", 0),
        ("mode", "quasistatic"),
        ("contacts", "palm"),
        ("mass_range", (0.1,)),
        ("friction_range", (0.4, float("inf"))),
        ("twist", -0.1),
        ("turn", float("inf")),
        ("mass_change", (0.0, 1.0)),
        ("friction_change", (1.0, 0.5)),
        ("torque_scale_range", (-1.0, 1.0)),
        ("render_mode", "human"),
        ("reward_weights", {"grip": 1.0}),
        ("reward_weights", {"effort": -1.0}),
        ("reward_weights", {"effort": float("nan")}),
        ("reward_weights", {"effort": "much"}),
        ("reward_weights", [1.0]),
        # other types than those that are asked for
        ("mode", None),
        ("mode", np.array(["static", "static"])),
        ("contacts", ["hand"]),
        ("announced", "False"),
        ("announced", 1),
        ("exact_quality", None),
        ("hand", "barrett"),
        ("grasps", 3),
        ("max_contacts", 5.0),
        ("max_contacts", True),
        ("max_contacts", 10**9),
        ("max_force", "20"),
        ("max_force", None),
        ("max_force", True),
        ("max_force", [20.0]),
        ("max_force", 1e7),
        ("max_force", 1e-300),
        ("preload", "2"),
        ("push", (1.0, 2.0)),
        ("push", 1e300),
        ("twist", None),
        ("turn", "half"),
        ("horizon", 10.5),
        ("horizon", 42.0),
        ("horizon", "42"),
        ("horizon", 10**9),
        ("mass_range", 0.3),
        ("mass_range", {"low": 0.1, "high": 0.2}),
        ("mass_range", "12"),
        ("mass_range", (0.1, 0.2, 0.3)),
        ("mass_range", (0.1, None)),
        ("mass_range", ("0.1", "0.2")),
        ("mass_change", (1e-300, 1.0)),
        ("friction_range", np.full((2, 2), 0.5)),
        ("friction_change", (True, True)),
        ("torque_scale_range", 1),
        ("render_mode", 3),
        ("render_mode", ["rgb_array"]),
        ("reward_weights", {1: 1.0}),
        ("reward_weights", {"effort": True}),
        ("reward_weights", 1.0),
    ],
)
def test_bad_arguments_are_named(argument: str, value: object) -> None:
    with pytest.raises(EnvironmentSettingsError, match=argument) as caught:
        GraspForceEnv(**{argument: value})  # type: ignore[arg-type]
    assert isinstance(caught.value, GraspForceError)
    assert repr(value) in str(caught.value)


@pytest.mark.parametrize(
    ("argument", "value"),
    [
        ("object_set", ["folder"]),
        ("object_set", None),
        ("object_set", b"random_urdfs"),
        ("split", 3),
        ("split", np.array(["test"])),
        ("target_size", "0.1"),
        ("target_size", True),
        ("target_size", [0.1]),
        ("target_size", float("nan")),
        ("object_ids", "010"),
        ("object_ids", 10),
        ("object_ids", [10, 20]),
        ("object_ids", []),
        ("object_ids", np.zeros(0, dtype=str)),
        ("object_ids", {"010": "020"}),
        ("object_ids", iter(["010"])),
    ],
)
def test_bad_objects_are_named(argument: str, value: object) -> None:
    with pytest.raises(ObjectSetError, match="ids" if argument == "object_ids" else None) as caught:
        GraspForceEnv(**{"split": "test", argument: value})  # type: ignore[arg-type]
    assert repr(value) in str(caught.value)


@pytest.mark.parametrize(
    ("argument", "values"),
    [
        ("mass_range", [(0.2, 0.3), [0.2, 0.3], np.array([0.2, 0.3])]),
        ("max_force", [10, 10.0, np.float32(10), np.int64(10)]),
        ("horizon", [3, np.int32(3)]),
        ("announced", [False, np.bool_(False)]),
        ("object_ids", [["010", "020"], ("020", "010"), {"010", "020"}, np.array(["010", "020"])]),
        ("reward_weights", [{"effort": 1}, {"effort": np.float64(1)}, RewardWeights(effort=1)]),
    ],
)
def test_what_is_unambiguous_is_accepted(argument: str, values: list[Any]) -> None:
    made = [GraspForceEnv(split="test", **{argument: value}) for value in values]
    for one in made[1:]:
        assert one.loads == made[0].loads
        assert one.settings == made[0].settings
        assert one.reward_weights == made[0].reward_weights
        assert (one.horizon, one.objects.object_ids) == (
            made[0].horizon,
            made[0].objects.object_ids,
        )
        assert one.observation_space == made[0].observation_space


def test_settings_check_themselves() -> None:
    with pytest.raises(EnvironmentSettingsError, match="mass_range"):
        LoadSettings(mass_range=0.3)  # type: ignore[arg-type]
    with pytest.raises(EnvironmentSettingsError, match="reward_weights"):
        RewardWeights(effort=-1.0)


@pytest.mark.parametrize("seed", [-1, 1.5, "1", True, [1]])
def test_bad_seeds_are_named(shared: GraspForceEnv, seed: Any) -> None:
    with pytest.raises(EnvironmentSettingsError, match="seed must be None or a whole number"):
        shared.reset(seed=seed)
    assert shared.reset(seed=np.int64(4))[1] == shared.reset(seed=4)[1]


def test_a_static_episode_has_one_step() -> None:
    with pytest.raises(EnvironmentSettingsError, match="horizon"):
        GraspForceEnv(mode="static", horizon=2)
    assert GraspForceEnv(mode="static", horizon=1).horizon == 1


def test_unknown_object_set() -> None:
    with pytest.raises(ObjectSetError):
        gym.make("GraspForce-v0", object_set="no_such_folder")


@pytest.mark.parametrize(
    "action",
    [
        np.zeros(23),
        np.zeros((8, 3)),
        np.zeros((1, 24)),
        np.full(24, np.nan),
        np.zeros(24, dtype=complex),
        np.zeros(24, dtype=bool),
        ["0"] * 24,
        [[0.0], 1.0],
        {"forces": 0.0},
        None,
        0.0,
        torch.zeros(24, requires_grad=True),
    ],
    ids=repr,
)
def test_bad_actions_are_refused(shared: GraspForceEnv, action: np.ndarray) -> None:
    shared.reset(seed=reseeded(0))
    with pytest.raises(EnvironmentSettingsError, match="24 numbers"):
        shared.step(action)
    # the episode goes on
    assert len(shared.step([0.0] * 24)) == 5


def test_actions_beyond_their_bounds_are_clipped(shared: GraspForceEnv) -> None:
    answers = []
    for largest in (1.0, 1e9, np.inf):
        shared.reset(seed=reseeded(0))
        answers.append(shared.step(np.tile([0.0, 0.0, largest], 8))[1:])
    assert answers[0] == answers[1] == answers[2]


def test_arguments_reach_the_episode(make: Callable[..., GraspForceEnv]) -> None:
    env = make(
        split="train",
        max_contacts=4,
        max_force=10.0,
        preload=1.0,
        friction_range=(0.5, 0.5),
        mass_range=(0.2, 0.2),
        horizon=3,
    )
    policy = SolverPolicy("dual_newton")
    # one in twenty loses its object
    episodes = (play(env, seed, lambda one: policy.predict(one)[0]) for seed in range(3, 13))
    steps = next(one for one in episodes if one[-1][4]["is_success"])
    assert len(steps) == 4
    assert steps[-1][4]["is_success"] is True
    assert not steps[0][4]["object_id"].endswith("0")
    for observation, *_ in steps:
        mask = observation["contact_mask"]
        assert len(mask) == 4
        np.testing.assert_allclose(observation["friction"], 0.5 * mask)
        np.testing.assert_allclose(observation["normal_min"], mask)
        np.testing.assert_allclose(observation["normal_max"], 10.0 * mask)
        weight = np.linalg.norm(observation["external_wrench"])
        assert weight == pytest.approx(0.2 * 9.80665, rel=1e-5)


def test_a_folder_of_meshes(tmp_path: Path) -> None:
    trimesh.creation.box((0.05, 0.06, 0.07)).export(tmp_path / "box.stl")
    env = GraspForceEnv(tmp_path)
    observation, info = env.reset(seed=reseeded(0))
    assert info["object_id"] == "box.stl"
    assert observation in env.observation_space
    env.close()


@pytest.mark.parametrize(
    ("edge", "message"), [(5e-4, "None of 200 attempts"), (50.0, "is its mesh in metres")]
)
def test_what_cannot_be_grasped(tmp_path: Path, edge: float, message: str) -> None:
    trimesh.creation.box((edge, edge, edge)).export(tmp_path / "box.stl")
    env = GraspForceEnv(tmp_path)
    with pytest.raises(AcquisitionError, match=message):
        env.reset(seed=reseeded(0))
    env.close()


# -- options of reset ------------------------------------------------------------------------------

GRAVITY = np.array([3.0, -4.0, 5.0])


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"gasp": 3}, "gasp"),
        ({"mass": 0.3, "weight": 2.0}, "weight"),
        ({"mass": 0.0}, "mass"),
        ({"mass": -1.0}, "mass"),
        ({"mass": float("nan")}, "mass"),
        ({"friction": float("inf")}, "friction"),
        ({"friction": 0.0}, "friction"),
        ({"gravity": [0.0, -9.8]}, "gravity"),
        ({"gravity": [0.0, float("nan"), 0.0]}, "gravity"),
        ({"grasp": -1}, "grasp"),
        ({"grasp": 10**9}, "grasp"),
        ({"grasp": "first"}, "grasp"),
        ({"grasp": 1.5}, "grasp"),
        ({"mass": "heavy"}, "mass"),
        ({"gravity": "down"}, "gravity"),
        ({"gravity": 9.8}, "gravity"),
        ({"gravity": [0.0, 0.0, 1e9]}, "gravity"),
        ({"gravity": [[0.0, 0.0, -9.8]]}, "gravity"),
        ({"gravity": [0, 0, 1j]}, "gravity"),
        ({"mass": True}, "mass"),
        ({"mass": [0.3]}, "mass"),
        ({"mass": 1e9}, "mass"),
        ({"friction": 1e-300}, "friction"),
        ({"grasp": True}, "grasp"),
        ({"grasp": None}, "grasp"),
        ({3: 1.0, "mass": 0.3}, "options of reset are grasp, mass, friction, gravity"),
        ([("mass", 0.3)], "options of reset are"),
        ("mass", "options of reset are"),
    ],
    ids=str,
)
def test_bad_options_are_named(shared: GraspForceEnv, options: dict[str, Any], named: str) -> None:
    with pytest.raises(EnvironmentSettingsError, match=named):
        shared.reset(seed=reseeded(0), options=options)
    with pytest.raises(ResetNeeded):
        shared.step(np.zeros(24))


def test_a_failed_attempt_is_no_grasp(shared: GraspForceEnv) -> None:
    known = shared.grasps._known
    for seed in range(50):
        shared.reset(seed=reseeded(seed))
        failed = [number for number in known if known[number] is None]
        if failed:
            break
    assert failed
    with pytest.raises(EnvironmentSettingsError, match=f"grasp.*{failed[0]}"):
        shared.reset(seed=reseeded(0), options={"grasp": failed[0]})


@pytest.mark.parametrize("mode", ["dynamic", "static"])
def test_options_fix_what_they_name(make: Callable[..., GraspForceEnv], mode: str) -> None:
    still = {"turn": 0.0, "push": 0.0, "twist": 0.0}
    unchanged = {"mass_change": (1.0, 1.0), "friction_change": (1.0, 1.0)}
    env = make(mode=mode, **still, **unchanged)
    free, info = env.reset(seed=reseeded(3))
    given = {"options": {"mass": 0.25, "friction": 0.55, "gravity": GRAVITY.tolist()}}
    observation, same = env.reset(seed=reseeded(3), **given)
    assert same["grasp"] == info["grasp"]
    mask = observation["contact_mask"]
    np.testing.assert_allclose(observation["friction"], 0.55 * mask, rtol=1e-6)
    weight = np.linalg.norm(observation["external_wrench"])
    assert weight == pytest.approx(0.25 * np.linalg.norm(GRAVITY), rel=1e-6)
    np.testing.assert_array_equal(observation["grasp_map"], free["grasp_map"])
    carried = episode_of(env).present.gravity_map @ GRAVITY
    np.testing.assert_allclose(observation["external_torque"], carried, rtol=1e-5, atol=1e-7)
    # options last for one episode, and are left as they were
    assert given == {"options": {"mass": 0.25, "friction": 0.55, "gravity": GRAVITY.tolist()}}
    again, _ = env.reset(seed=reseeded(3))
    assert_same([(free, 0.0, False, False, info)], [(again, 0.0, False, False, info)])


@pytest.mark.parametrize("mode", ["dynamic", "static"])
def test_the_number_of_a_grasp_gives_that_grasp(
    make: Callable[..., GraspForceEnv], mode: str
) -> None:
    env, other = make(mode=mode), make(mode=mode)
    for seed in range(3):
        first, info = env.reset(seed=reseeded(seed))
        for seed_of_the_rest in (50, 51):
            again, told = other.reset(
                seed=seed_of_the_rest, options={"grasp": np.int64(info["grasp"])}
            )
            assert type(told["grasp"]) is int
            assert told["grasp"] == info["grasp"]
            assert told["object_id"] == info["object_id"]
            for name in ("grasp_map", "hand_jacobian", "contact_mask"):
                np.testing.assert_array_equal(first[name], again[name])
            assert not np.array_equal(first["external_wrench"], again["external_wrench"])


def test_fixing_the_grasp_shifts_nothing_else(shared: GraspForceEnv) -> None:
    loads = []
    for options in ({}, {"grasp": shared.reset(seed=reseeded(1))[1]["grasp"]}):
        observation, _ = shared.reset(seed=reseeded(2), options=options)
        size = np.linalg.norm(observation["external_wrench"])
        loads.append((round(float(size), 5), float(observation["friction"][0])))
    assert loads[0] == loads[1]


def test_reward_weights_may_be_told_by_name(make: Callable[..., GraspForceEnv]) -> None:
    plain = make(mode="static")
    priced = make(mode="static", reward_weights={"effort": 1.0, "q_lrw": 0})
    assert priced.reward_weights == RewardWeights(effort=1.0, q_lrw=0.0)
    infos = []
    for env in (plain, priced):
        env.reset(seed=reseeded(0))
        infos.append(env.step(np.full(env.action_space.shape, 0.1, dtype=np.float32))[-1])
    assert infos[0]["reward_effort"] < 0.0
    assert infos[1]["reward_effort"] == pytest.approx(10.0 * infos[0]["reward_effort"])
    assert infos[1]["reward_q_lrw"] == 0.0
