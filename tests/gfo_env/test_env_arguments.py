"""What may be passed to the environment and to its reset, and the errors for what may not."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import trimesh
from gymnasium.error import ResetNeeded

from gfo_env.env import GraspForceEnv
from gfo_env.exceptions import AcquisitionError, EnvironmentSettingsError, ObjectSetError
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
    ],
)
def test_bad_arguments_are_named(argument: str, value: object) -> None:
    with pytest.raises(EnvironmentSettingsError, match=argument) as caught:
        GraspForceEnv(**{argument: value})  # type: ignore[arg-type]
    assert isinstance(caught.value, GraspForceError)
    assert repr(value) in str(caught.value)


def test_a_static_episode_has_one_step() -> None:
    with pytest.raises(EnvironmentSettingsError, match="horizon"):
        GraspForceEnv(mode="static", horizon=2)
    assert GraspForceEnv(mode="static", horizon=1).horizon == 1


def test_unknown_object_set() -> None:
    with pytest.raises(ObjectSetError):
        gym.make("GraspForce-v0", object_set="no_such_folder")


@pytest.mark.parametrize("action", [np.zeros(23), np.zeros((8, 3)), np.full(24, np.nan)])
def test_bad_actions_are_refused(shared: GraspForceEnv, action: np.ndarray) -> None:
    shared.reset(seed=reseeded(0))
    with pytest.raises(EnvironmentSettingsError, match="24 numbers"):
        shared.step(action)


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
    policy = SolverPolicy("dual_newton", max_force=10.0)
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
