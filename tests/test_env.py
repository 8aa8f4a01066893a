"""`GraspForce-v0`: the contract with Gymnasium and Stable-Baselines3, determinism, episodes."""

import gc
import pickle
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import trimesh
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import FlattenObservation, RecordEpisodeStatistics, TimeLimit
from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env as check_env_for_sb3

import gfo_env  # noqa: F401 (registers the environment)
from gfo_env.conditions import PRELOAD
from gfo_env.env import GraspForceEnv
from gfo_env.exceptions import AcquisitionError, EnvironmentSettingsError, ObjectSetError
from gfo_env.observation import unpack
from gfo_env.policy import SolverPolicy
from gfo_env.reward import TERMS
from solvers import GraspForceError, GraspForceProblem, residuals

Act = Callable[[dict[str, Any]], np.ndarray]
Step = tuple[dict[str, Any], float, bool, bool, dict[str, Any]]

FIELDS = (
    "grasp_map",
    "hand_jacobian",
    "friction",
    "torque_min",
    "torque_max",
    "external_torque",
    "external_wrench",
    "normal_min",
    "normal_max",
    "contact_mask",
)
INFO = {
    "is_success",
    "force_closure",
    "q_lrw",
    "wrench_residual",
    "friction_violation",
    "torque_violation",
    "object_id",
    "effort",
    "grasp",
} | {f"reward_{name}" for name in TERMS}


@pytest.fixture
def make() -> Iterator[Callable[..., gym.Env[Any, Any]]]:
    made: list[gym.Env[Any, Any]] = []

    def factory(**arguments: Any) -> gym.Env[Any, Any]:
        made.append(gym.make("GraspForce-v0", **{"split": "test"} | arguments))
        return made[-1]

    yield factory
    for env in made:
        env.close()


@pytest.fixture(scope="module")
def shared() -> Iterator[GraspForceEnv]:
    """For tests that begin with a seeded reset, which leaves no trace of the test before."""
    env = GraspForceEnv(split="test")
    yield env
    env.close()


def zeros(observation: dict[str, Any]) -> np.ndarray:
    return np.zeros(3 * len(observation["friction"]), np.float32)


def random_actions(seed: int) -> Act:
    rng = np.random.default_rng(seed)
    return lambda observation: rng.uniform(-1, 1, 3 * len(observation["friction"]))


ORACLE = SolverPolicy("clarabel")


def oracle(observation: dict[str, Any]) -> np.ndarray:
    return ORACLE.predict(observation)[0]


def play(env: gym.Env[Any, Any], seed: int, act: Act) -> list[Step]:
    """An episode from reset, in the form of a step without a reward, to its end."""
    observation, info = env.reset(seed=seed)
    steps: list[Step] = [(observation, 0.0, False, False, info)]
    while not (steps[-1][2] or steps[-1][3]):
        steps.append(env.step(act(steps[-1][0])))
    return steps


def assert_same(one: list[Step], other: list[Step]) -> None:
    assert len(one) == len(other)
    for a, b in zip(one, other, strict=True):
        assert a[1:] == b[1:]
        for name in FIELDS:
            np.testing.assert_array_equal(a[0][name], b[0][name])


# -- the contract ----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["GraspForce-v0", "gfo_env:GraspForce-v0"])
def test_gymnasium_finds_nothing_to_complain_about(name: str) -> None:
    check_env(gym.make(name, disable_env_checker=True).unwrapped, skip_render_check=False)


@pytest.mark.parametrize("render_mode", [None, "rgb_array"])
def test_stable_baselines_finds_nothing_to_complain_about(render_mode: str | None) -> None:
    check_env_for_sb3(GraspForceEnv(split="test", render_mode=render_mode), skip_render_check=False)


def test_spaces(shared: GraspForceEnv) -> None:
    space = shared.observation_space
    assert isinstance(space, gym.spaces.Dict)
    assert set(space) == set(FIELDS)
    sizes = {name: box.shape for name, box in space.items()}
    assert sizes["grasp_map"] == (6 * 24,)
    assert sizes["hand_jacobian"] == (24 * 8,)
    assert {box.dtype for box in space.values()} == {np.dtype(np.float32)}
    assert shared.action_space == gym.spaces.Box(-1.0, 1.0, (24,), np.float32)


@pytest.mark.parametrize(
    "act", [zeros, oracle, random_actions(0)], ids=["zero", "oracle", "random"]
)
def test_episodes_keep_the_contract(shared: GraspForceEnv, act: Act) -> None:
    for seed in range(4):
        steps = play(shared, seed, act)
        for observation, reward, terminated, truncated, info in steps:
            assert observation in shared.observation_space
            assert set(info) == INFO
            assert {type(info[key]) for key in INFO - {"object_id", "grasp"}} <= {bool, float}
            assert type(info["grasp"]) is int
            assert all(np.isfinite(info[key]) for key in INFO - {"object_id"})
            assert info["object_id"] in shared.objects
            assert reward == pytest.approx(sum(info[f"reward_{name}"] for name in TERMS), abs=1e-12)
            assert info["is_success"] is (truncated and not terminated)
            assert not (terminated and truncated)
        assert steps[-1][2] or len(steps) == shared.horizon + 1
        assert {step[4]["object_id"] for step in steps} == {steps[0][4]["object_id"]}


def test_observation_is_the_problem(shared: GraspForceEnv) -> None:
    observation, _ = shared.reset(seed=3)
    fields = unpack(observation)
    problem = GraspForceProblem(**fields).without_padding()
    n = problem.n_contacts
    assert 3 <= n < 8
    assert np.array_equal(fields["contact_mask"], np.arange(8) < n)
    frames = problem.grasp_map[:3].reshape(3, n, 3).transpose(1, 0, 2)
    np.testing.assert_allclose(
        frames.transpose(0, 2, 1) @ frames, np.broadcast_to(np.eye(3), (n, 3, 3)), atol=1e-6
    )
    np.testing.assert_allclose(np.linalg.det(frames), 1.0, atol=1e-6)
    assert (problem.normal_min == PRELOAD).all()
    assert (problem.normal_max == 20.0).all()
    assert len(set(problem.friction)) == 1
    np.testing.assert_allclose(problem.torque_max, shared.hand.max_torque)
    np.testing.assert_array_equal(problem.torque_min, -problem.torque_max)
    # the first load is the weight alone, without a torque about the centre of mass
    weight = np.linalg.norm(problem.external_wrench[:3]) / 9.80665
    assert 0.1 <= weight <= 0.5
    assert not problem.external_wrench[3:].any()


def test_measures_are_those_of_the_solution(shared: GraspForceEnv) -> None:
    observation, _ = shared.reset(seed=5)
    problem = GraspForceProblem(**unpack(observation))
    action = shared.action_space.sample()
    forces = 20.0 * action.astype(np.float64) * np.repeat(observation["contact_mask"], 3)
    _, _, _, _, info = shared.step(action)
    for key, function in (
        ("wrench_residual", residuals.equilibrium_residual),
        ("friction_violation", residuals.friction_violation),
        ("torque_violation", residuals.torque_violation),
    ):
        assert info[key] == pytest.approx(float(function(problem, forces)), rel=1e-4, abs=1e-6)


def test_a_load_lasts_six_steps(make: Callable[..., gym.Env[Any, Any]]) -> None:
    env = make(twist=0.0, turn=0.0, mass_change=(1.0, 1.0), friction_change=(1.0, 1.0))
    sizes = [float(np.linalg.norm(s[0]["external_wrench"])) for s in play(env, 2, oracle)]
    changes = np.flatnonzero(~np.isclose(sizes[1:], sizes[:-1], rtol=1e-5)) + 1
    assert len(sizes) == 43
    assert changes.tolist() == [6, 12, 18, 24, 30, 36]


def test_values_beyond_the_bounds_are_clipped_and_padding_is_ignored(shared: GraspForceEnv) -> None:
    observation, _ = shared.reset(seed=1)
    action = np.sign(np.random.default_rng(0).normal(size=24))
    inside = shared.step(action)
    shared.reset(seed=1)
    contacts = int(observation["contact_mask"].sum())
    action[3 * contacts :] = 0.3
    beyond = shared.step(np.where(np.abs(action) == 1.0, 7.0 * action, action))
    assert_same([inside], [beyond])


# -- determinism -----------------------------------------------------------------------------------


def test_same_seed_same_bits(make: Callable[..., gym.Env[Any, Any]]) -> None:
    one, other = make(), make(render_mode="rgb_array")
    first = play(one, 11, random_actions(1)), play(one, 12, oracle)
    other.reset(seed=99)
    other.render()
    assert_same(first[1], play(other, 12, oracle))
    other.close()
    assert_same(first[0], play(other, 11, random_actions(1)))


def test_later_episodes_follow_from_the_first_seed(shared: GraspForceEnv) -> None:
    def three() -> list[Step]:
        steps = play(shared, 21, zeros)
        for _ in range(2):
            observation, info = shared.reset()
            steps.append((observation, 0.0, False, False, info))
        return steps

    once = three()
    assert_same(once, three())
    resets = [step[0]["external_wrench"].tobytes() for step in (once[0], *once[-2:])]
    assert len(set(resets)) == 3


def test_different_seeds_differ(shared: GraspForceEnv) -> None:
    starts = [shared.reset(seed=seed) for seed in range(6)]
    assert len({start[0]["grasp_map"].tobytes() for start in starts}) == 6
    assert len({start[0]["friction"].tobytes() for start in starts}) == 6
    assert len({start[1]["object_id"] for start in starts}) > 1


@pytest.mark.parametrize("mode", ["sync", "async"])
def test_vectors_reproduce_single_environments(shared: GraspForceEnv, mode: str) -> None:
    envs = gym.make_vec("GraspForce-v0", num_envs=2, vectorization_mode=mode, split="test")
    try:
        observations, infos = envs.reset(seed=31)
        actions, _ = ORACLE.predict(observations)
        after, rewards, _, _, _ = envs.step(actions)
        for index in range(2):
            observation, info = shared.reset(seed=31 + index)
            assert infos["object_id"][index] == info["object_id"]
            alone = shared.step(oracle(observation))
            assert rewards[index] == pytest.approx(alone[1], abs=1e-6)
            for name in FIELDS:
                np.testing.assert_array_equal(observations[name][index], observation[name])
                np.testing.assert_allclose(after[name][index], alone[0][name], atol=1e-5)
    finally:
        envs.close()


@pytest.mark.slow
def test_spawned_workers_reproduce_forked_ones() -> None:
    starts = []
    for context in ("fork", "spawn"):
        envs = gym.make_vec(
            "gfo_env:GraspForce-v0",
            num_envs=2,
            vectorization_mode="async",
            vector_kwargs={"context": context},
            split="test",
        )
        starts.append(envs.reset(seed=7)[0])
        envs.close()
    for name in FIELDS:
        np.testing.assert_array_equal(starts[0][name], starts[1][name])


# -- what holds and what does not ------------------------------------------------------------------


def test_zero_forces_drop_every_object(shared: GraspForceEnv) -> None:
    for seed in range(8):
        steps = play(shared, seed, zeros)
        assert steps[-1][2]
        assert steps[-1][1] < -0.7
        assert not any(step[4]["is_success"] for step in steps)


def test_optimal_forces_hold_most_objects(shared: GraspForceEnv) -> None:
    held = [play(shared, 100 + seed, oracle)[-1][4]["is_success"] for seed in range(10)]
    assert sum(held) >= 7


def test_reward_prefers_optimal_forces(shared: GraspForceEnv) -> None:
    for seed in range(3):
        _, best, _, _, _ = play(shared, 200 + seed, oracle)[1]
        for act in (zeros, random_actions(seed)):
            assert play(shared, 200 + seed, act)[1][1] < best


def test_a_slipped_object_is_observed_without_contacts(shared: GraspForceEnv) -> None:
    """Stepping on after the end is not of use, but must not fail: vectors of environments do it."""
    seen = set()
    for seed in range(6):
        shared.reset(seed=seed)
        for _ in range(8):
            observation, _, terminated, _, info = shared.step(np.zeros(24))
            assert observation in shared.observation_space
            contacts = int(observation["contact_mask"].sum())
            seen.add(contacts)
            if contacts == 0:
                assert terminated
                assert not info["force_closure"]
                assert not observation["grasp_map"].any()
    assert 0 in seen


# -- arguments and errors --------------------------------------------------------------------------


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
        ("render_mode", "human"),
    ],
)
def test_bad_arguments_are_named(argument: str, value: object) -> None:
    with pytest.raises(EnvironmentSettingsError, match=argument) as caught:
        GraspForceEnv(**{argument: value})  # type: ignore[arg-type]
    assert isinstance(caught.value, GraspForceError)


def test_unknown_object_set() -> None:
    with pytest.raises(ObjectSetError):
        gym.make("GraspForce-v0", object_set="no_such_folder")


@pytest.mark.parametrize("action", [np.zeros(23), np.zeros((8, 3)), np.full(24, np.nan)])
def test_bad_actions_are_refused(shared: GraspForceEnv, action: np.ndarray) -> None:
    shared.reset(seed=0)
    with pytest.raises(EnvironmentSettingsError, match="24 numbers"):
        shared.step(action)


def test_arguments_reach_the_episode(make: Callable[..., gym.Env[Any, Any]]) -> None:
    env = make(
        split="train",
        max_contacts=4,
        max_force=10.0,
        preload=1.0,
        friction_range=(0.5, 0.5),
        mass_range=(0.2, 0.2),
        horizon=3,
    )
    policy = SolverPolicy("clarabel", max_force=10.0)
    steps = play(env, 3, lambda observation: policy.predict(observation)[0])
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
    observation, info = env.reset(seed=0)
    assert info["object_id"] == "box.stl"
    assert observation in env.observation_space
    env.close()


@pytest.mark.parametrize(
    ("edge", "message"), [(0.002, "None of 200 attempts"), (50.0, "is its mesh in metres")]
)
def test_what_cannot_be_grasped(tmp_path: Path, edge: float, message: str) -> None:
    trimesh.creation.box((edge, edge, edge)).export(tmp_path / "box.stl")
    env = GraspForceEnv(tmp_path)
    with pytest.raises(AcquisitionError, match=message):
        env.reset(seed=0)
    env.close()


# -- life cycle ------------------------------------------------------------------------------------


def test_close_twice_and_open_again() -> None:
    env = GraspForceEnv(split="test")
    env.close()
    first = play(env, 4, zeros)
    env.close()
    env.close()
    with pytest.raises(ResetNeeded):
        env.step(np.zeros(24))
    with pytest.raises(ResetNeeded):
        env.render()
    assert_same(first, play(env, 4, zeros))
    env.close()


def test_pickles_before_and_after_use() -> None:
    env = GraspForceEnv(split="test", preload=1.0)
    unused = pickle.loads(pickle.dumps(env))
    steps = play(env, 4, zeros)
    used = pickle.loads(pickle.dumps(env))
    with pytest.raises(ResetNeeded):
        used.step(np.zeros(24))
    for copy in (unused, used):
        assert copy.settings.preload == 1.0
        assert_same(steps, play(copy, 4, zeros))
        copy.close()
    env.close()


def test_an_environment_that_nobody_closes_leaves_nothing_behind() -> None:
    env = GraspForceEnv(split="test")
    env.reset(seed=0)
    folder, client = env.simulation._folder, env.simulation.client
    bullet = env.simulation.bullet
    assert folder.is_dir()
    assert bullet.isConnected(client)
    del env
    gc.collect()
    assert not folder.exists()
    assert not bullet.isConnected(client)


WITHOUT_GYMNASIUM = """
import sys

class Absent:
    @staticmethod
    def find_spec(name, path=None, target=None):
        if name.partition(".")[0] in ("gymnasium", "pybullet", "trimesh"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Absent)
import gfo_env.observation, gfo_env.policy, gfo_env.reward
"""


def test_modules_of_a_training_node_need_no_gymnasium() -> None:
    root = Path(__file__).resolve().parents[1]
    subprocess.run([sys.executable, "-c", WITHOUT_GYMNASIUM], cwd=root, check=True)


def test_wrappers(make: Callable[..., gym.Env[Any, Any]]) -> None:
    env = RecordEpisodeStatistics(TimeLimit(FlattenObservation(make()), max_episode_steps=2))
    observation, _ = env.reset(seed=6)
    assert observation in env.observation_space
    assert observation.shape == (6 * 24 + 24 * 8 + 3 * 8 + 6 + 4 * 8,)
    env.step(np.zeros(24, np.float32))
    _, _, _, truncated, info = env.step(np.zeros(24, np.float32))
    assert truncated
    assert info["episode"]["l"] == 2
    assert info["is_success"] is False


def test_ppo_learns_without_complaint(make: Callable[..., gym.Env[Any, Any]]) -> None:
    model = PPO("MultiInputPolicy", make(), n_steps=64, batch_size=32, n_epochs=1, seed=0)
    model.learn(128)
    observation, _ = make().reset(seed=0)
    action, _ = model.predict(observation)
    assert action.shape == (24,)
    assert len(model.ep_success_buffer) > 0
