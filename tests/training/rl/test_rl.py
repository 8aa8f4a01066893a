"""Agents of stable-baselines3: training, going on after a kill, and what their actions mean."""

import base64
import io
import json
import os
import pickle
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from stable_baselines3.common.env_checker import check_env

import gfo_env
from gfo_env.conditions import FRICTION_FACTOR
from gfo_env.exceptions import EnvironmentSettingsError
from gfo_env.grasps.collection import CollectionPlan, collect
from gfo_env.mdp.observation import unpack
from gfo_env.mdp.reward import RewardWeights
from gfo_env.policy import SolverPolicy
from solvers import GraspForceProblem, make_solver, solve
from solvers.problem import residuals
from tests.support.commands import assert_one_clear_line, run_command
from tests.support.seeds import reseeded, seeded
from tests.support.world import held_out_objects
from training.networks.settings import TrainingError
from training.rl.actions import ConeActions
from training.rl.features import LoadFeatures
from training.rl.hyperparameters import hyperparameters
from training.rl.network import ContactExtractor, ContactHead
from training.rl.planning import Planner, PreloadPolicy, measured_wrench
from training.rl.preloads import PreloadActions
from training.rl.quality_policy import QualityPolicy
from training.rl.reactions import ReactionActorCritic
from training.rl.reactive import ReactivePolicy
from training.rl.residual import ResidualForces, ResidualWrench
from training.rl.runs import learning_curve, load_agent
from training.rl.settings import RlSettings, key_values
from training.rl.trainer import train_rl

STATIC, DYNAMIC, FELT = "GraspForceStatic-v0", "GraspForce-v0", "GraspForceUnannounced-v0"
assert gfo_env

SMALL = {
    "ppo": ("n_steps:32", "batch_size:64", "n_epochs:2"),
    "sac": ("learning_starts:50", "batch_size:32", "buffer_size:500"),
    "td3": ("learning_starts:50", "batch_size:32", "buffer_size:500"),
}


@pytest.fixture(scope="session")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A table of grasps of held-out objects, so that nothing is made anew in each test."""
    path = tmp_path_factory.mktemp("grasps") / "few.npz"
    collect(CollectionPlan(held_out_objects(), 20, 0), workers=1, output=path)
    return path


@pytest.fixture
def make(table: Path) -> Callable[..., gym.Env[Any, Any]]:
    def build(name: str, **settings: Any) -> gym.Env[Any, Any]:
        return gym.make(name, disable_env_checker=True, split="test", grasps=str(table), **settings)

    return build


@pytest.fixture
def settings(table: Path, tmp_path: Path) -> Callable[..., RlSettings]:
    def build(algo: str, env: str = STATIC, **changes: Any) -> RlSettings:
        defaults: dict[str, Any] = {
            "output": tmp_path / "run",
            "env_kwargs": ("split:test", f"grasps:{table}"),
            "steps": 256,
            "envs": 2,
            "evaluate_every": 128,
            "evaluation_episodes": 4,
            "checkpoint_every": 128,
            "hyperparams": SMALL[algo],
        }
        return RlSettings(algo=algo, env=env, **defaults | changes)  # type: ignore[arg-type]

    return build


def weights(folder: Path) -> list[torch.Tensor]:
    return list(load_agent.__wrapped__(folder).model.policy.state_dict().values())


# -- training --------------------------------------------------------------------------------------


@pytest.mark.parametrize("algo", ["ppo", "sac", "td3"])
@pytest.mark.parametrize(
    ("env", "policy", "arguments"),
    [
        (STATIC, "scratch", ()),
        (STATIC, "preloads", ("preload:0",)),
        (STATIC, "residual_forces", ()),
        (FELT, "residual", ("horizon:8",)),
    ],
    ids=["scratch", "preloads", "forces", "wrench"],
)
def test_every_algorithm_trains(settings, table, algo, env, policy, arguments) -> None:
    arguments = ("split:test", f"grasps:{table}", *arguments)
    run = settings(algo, env, policy=policy, env_kwargs=arguments, steps=128, checkpoint_every=64)
    summary = train_rl(run)
    assert summary.steps >= 128
    assert np.isfinite(summary.reward)
    assert 0.0 <= summary.hold_rate <= 1.0
    steps, returns = learning_curve(run.output)
    assert steps.tolist() == [0, 128]
    assert np.isfinite(returns).all()
    assert {path.name for path in run.output.iterdir()} == {
        f"checkpoint_{summary.steps}",
        "evaluations.npz",
        "hyperparameters.json",
        "model.zip",
        "settings.json",
        "tensorboard",
        "agent.npz",
    }


@pytest.mark.parametrize(
    ("algo", "policy"), [("ppo", "scratch"), ("sac", "scratch"), ("ppo", "preloads")]
)
def test_a_killed_run_ends_like_one_that_was_not(settings, tmp_path, algo, policy) -> None:
    whole = settings(algo, policy=policy, output=tmp_path / "whole")
    assert train_rl(whole).steps == 256

    def kill(steps: int) -> None:
        if steps >= 200:
            raise KeyboardInterrupt

    parts = settings(algo, policy=policy, output=tmp_path / "parts")
    with pytest.raises(KeyboardInterrupt):
        train_rl(parts, on_step=kill)
    assert (parts.output / "checkpoint_128").is_dir()
    seen: list[int] = []
    assert train_rl(parts, on_step=seen.append).steps == 256
    assert seen[0] == 130
    for one, other in zip(weights(whole.output), weights(parts.output), strict=True):
        assert torch.equal(one, other)
    for one, other in zip(learning_curve(whole.output), learning_curve(parts.output), strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_finished_run_is_left_alone_and_may_be_prolonged(settings) -> None:
    first = train_rl(settings("ppo"))
    before = weights(first.model.parent)
    assert train_rl(settings("ppo")) == first
    assert all(map(torch.equal, before, weights(first.model.parent)))
    assert train_rl(settings("ppo", steps=384)).steps == 384


def test_another_run_is_not_gone_on_with(settings) -> None:
    train_rl(settings("ppo", steps=64))
    for change in ({"seed": 1}, {"hyperparams": (*SMALL["ppo"], "learning_rate:0.1")}):
        with pytest.raises(TrainingError, match="other settings"):
            train_rl(settings("ppo", **change))


def test_processes_give_the_same_run(settings, tmp_path) -> None:
    one = settings("ppo", output=tmp_path / "one", steps=64)
    other = settings("ppo", output=tmp_path / "other", steps=64, vector="subproc")
    # not the same bits: one kind of vector rounds rewards to float32, the other does not
    assert train_rl(one).reward == pytest.approx(train_rl(other).reward, abs=1e-4)
    for mine, theirs in zip(weights(one.output), weights(other.output), strict=True):
        torch.testing.assert_close(mine, theirs, atol=1e-4, rtol=1e-4)


def test_an_agent_plays_what_it_was_trained_on(settings, make) -> None:
    run = settings("ppo", steps=64)
    train_rl(run)
    agent = load_agent(run.output)
    env = agent.wrap(make(STATIC))
    observation, _ = env.reset(seed=reseeded(0))
    action, _ = agent.predict(observation)
    assert env.action_space.contains(action)
    env.step(action)
    with pytest.raises(TrainingError, match="other observations"):
        agent.wrap(make(FELT))


class Trap:
    """What must never be called."""

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return os.mkdir, ("sprung",)


def with_trap(model: bytes) -> bytes:
    """A model's zip in whose data every pickle is a trap."""
    trap = {":serialized:": base64.b64encode(pickle.dumps(Trap())).decode()}
    content = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(model)) as old, zipfile.ZipFile(content, "w") as new:
        for name in old.namelist():
            kept = old.read(name)
            if name == "data":
                names = [*json.loads(kept), "trap"]
                kept = json.dumps(dict.fromkeys(names, trap)).encode()
            new.writestr(name, kept)
    return content.getvalue()


def damaged(content: bytes) -> list[bytes]:
    """A file that is empty, cut short, something else, or has one bit that is wrong."""
    flipped = bytearray(content)
    flipped[len(content) // 2] ^= 4
    return [b"", content[: len(content) // 2], b"text", pickle.dumps(Trap()), bytes(flipped)]


def test_agents_are_data_and_damaged_ones_are_named(settings, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    run = settings("ppo", steps=64)
    train_rl(run)
    whole = weights(run.output)
    model = run.output / "model.zip"
    content = model.read_bytes()
    model.write_bytes(with_trap(content))
    (run.output / "vecnormalize.pkl").write_bytes(pickle.dumps(Trap()))
    assert all(map(torch.equal, whole, weights(run.output)))
    model.write_bytes(content)
    names = ("agent.npz", "model.zip", "settings.json", "hyperparameters.json")
    for path in map(run.output.joinpath, names):
        content = path.read_bytes()
        for other in damaged(content)[: -1 if path.suffix == ".json" else None]:
            path.write_bytes(other)
            with pytest.raises(TrainingError, match=f"{run.output}"):
                weights(run.output)
        path.write_bytes(content)
    values = json.loads((run.output / "settings.json").read_text())
    for change in ({"steps": "many"}, {"algo": "dqn"}, {"envs": 10**9}, {"more": 1}):
        (run.output / "settings.json").write_text(json.dumps(values | change))
        with pytest.raises(TrainingError, match=r"settings of a run|envs is"):
            weights(run.output)
    (run.output / "settings.json").write_text(json.dumps(values))
    path = run.output / "evaluations.npz"
    for other in damaged(path.read_bytes()):
        path.write_bytes(other)
        with pytest.raises(TrainingError, match="evaluations"):
            learning_curve(run.output)
    assert all(map(torch.equal, whole, weights(run.output)))
    assert not (tmp_path / "sprung").exists()


def test_damaged_checkpoints_are_named_and_never_run(settings, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    run = settings("sac", steps=64, checkpoint_every=64)
    train_rl(run)
    longer = settings("sac", steps=128, checkpoint_every=64)
    (checkpoint,) = run.output.glob("checkpoint_*")
    assert {path.name for path in checkpoint.iterdir()} == {
        "agent.npz",
        "model.zip",
        "progress.json",
        "replay_buffer.npz",
    }
    (checkpoint / "model.zip").write_bytes(with_trap((checkpoint / "model.zip").read_bytes()))
    for path in checkpoint.iterdir():
        content = path.read_bytes()
        for other in damaged(content)[: -1 if path.suffix == ".json" else None]:
            path.write_bytes(other)
            with pytest.raises(TrainingError, match=rf"{checkpoint} is damaged.*delete it"):
                train_rl(longer)
        path.unlink()
        with pytest.raises(TrainingError, match=rf"{checkpoint} is damaged.*delete it"):
            train_rl(longer)
        path.write_bytes(content)
    assert train_rl(longer).steps == 128
    assert not (tmp_path / "sprung").exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"seed": -1}, "seed is -1"),
        ({"seed": 2**31}, "seed is"),
        ({"steps": 0}, "steps is 0"),
        ({"envs": 10**6}, "envs is"),
        ({"hyperparams": ("learning_rate:.nan",)}, "learning_rate is nan"),
        ({"hyperparams": ("learning_rate:-1.0",)}, "cannot be set up"),
        ({"hyperparams": ("noise_std:-1.0",)}, "noise_std is -1.0"),
        ({"hyperparams": ("noise_std:much",)}, "cannot be read"),
        ({"hyperparams": ("normalize: {clip_obs: .inf}",)}, "clip_obs is inf"),
        ({"hyperparams": ("normalize: {clip: 1}",)}, "cannot be set up"),
        ({"hyperparams": ("policy_kwargs: {net_arch: [-1]}", "network:mlp")}, "cannot be set up"),
    ],
)
def test_settings_that_cannot_be_met_are_refused(settings, change, message) -> None:
    with pytest.raises(TrainingError, match=message):
        train_rl(settings("ppo", **change))


# -- what actions mean -----------------------------------------------------------------------------


def test_no_correction_is_the_solver_to_the_bit(make) -> None:
    plain = make(FELT, horizon=9)
    for wrapped, policy in (
        (ResidualWrench(make(FELT, horizon=9)), SolverPolicy("dual_newton")),
        (ResidualForces(make(FELT, horizon=9)), SolverPolicy("dual_newton")),
        (ResidualWrench(make(FELT, horizon=9), reactive=True), ReactivePolicy()),
    ):
        zero = np.zeros(wrapped.action_space.shape, np.float32)
        for seed in range(3):
            seen, _ = plain.reset(seed=reseeded(seed))
            also, _ = wrapped.reset(seed=reseeded(seed))
            state, done = None, False
            while not done:
                assert all(np.array_equal(seen[name], also[name]) for name in seen)
                action, state = policy.predict(seen, state)
                seen, reward, terminated, truncated, info = plain.step(action)
                also, *rest = wrapped.step(zero)
                assert rest == [reward, terminated, truncated, info]
                done = terminated or truncated
        wrapped.close()
    plain.close()


@pytest.mark.parametrize("wrapper", [ConeActions, ResidualWrench, ResidualForces])
def test_wrappers_keep_the_contract(make, wrapper) -> None:
    check_env(wrapper(make(FELT, horizon=4)), skip_render_check=True)


@pytest.mark.parametrize("wrapper", [ConeActions, PreloadActions, ResidualWrench, ResidualForces])
def test_wrappers_take_actions_of_their_own_alone(make, wrapper) -> None:
    env = wrapper(make(STATIC))
    size = env.action_space.shape[0]
    right = np.zeros(size, np.float32)
    with pytest.raises(ResetNeeded):
        env.step(right)
    env.reset(seed=reseeded(0))
    for wrong in (np.zeros(size + 1), np.zeros((1, size)), np.zeros(1), right + np.nan, None, "0"):
        with pytest.raises(EnvironmentSettingsError, match=f"An action is {size} numbers"):
            env.step(wrong)
    env.step(right)
    env.close()


def test_wrappers_are_for_this_environment() -> None:
    for wrapper in (ConeActions, PreloadActions, ResidualWrench, ResidualForces):
        with pytest.raises(TrainingError, match="CartPoleEnv, not one of gfo_env"):
            wrapper(gym.make("CartPole-v1"))


@pytest.mark.parametrize(
    "make_policy",
    [
        ReactivePolicy,
        lambda: PreloadPolicy("dual_newton", 1.0),
        lambda: QualityPolicy(make_solver("uniform_preload"), RewardWeights()),
        lambda: SolverPolicy("dual_newton"),
    ],
    ids=["reactive", "preload", "quality", "solver"],
)
def test_vectors_are_answered_like_their_members(make, make_policy) -> None:
    """Episodes side by side, one of which begins anew, are acted on as each would be alone."""
    policy = make_policy()
    envs = [make(FELT, horizon=6, max_force=force) for force in (10.0, 20.0, 40.0)]
    seen = [env.reset(seed=reseeded(seed))[0] for seed, env in enumerate(envs)]
    state, alone = None, [None] * len(envs)
    for step in range(4):
        starts = np.array([step == 0, step == 0, step in (0, 2)])
        batch = {name: np.stack([one[name] for one in seen]) for name in seen[0]}
        actions, state = policy.predict(batch, state, starts)
        assert actions.shape == (3, 24)
        assert actions.dtype == np.float32
        for index, env in enumerate(envs):
            one = policy.predict(seen[index], alone[index], starts[index : index + 1])
            np.testing.assert_allclose(actions[index], one[0], atol=1e-6)
            alone[index] = one[1]
            seen[index] = env.step(actions[index])[0]


@pytest.mark.parametrize("max_force", [10.0, 40.0])
def test_policies_command_newtons_whatever_the_largest_force(make, max_force) -> None:
    """Where no cap binds, a force is the same force."""
    light = {"mass_range": (0.05, 0.06), "preload": 0.5}
    usual, other = make(STATIC, **light), make(STATIC, **light, max_force=max_force)
    same = 0
    for policy in (ReactivePolicy(), PreloadPolicy("dual_newton", 1.0)):
        for seed in range(8):
            one, _ = usual.reset(seed=reseeded(seed))
            two, _ = other.reset(seed=reseeded(seed))
            fields = unpack(one) | {"friction": FRICTION_FACTOR * unpack(one)["friction"]}
            forces = 20.0 * policy.predict(one)[0].astype(np.float64)
            again = max_force * policy.predict(two)[0].astype(np.float64)
            if solve(GraspForceProblem(**fields)).status == "optimal" and forces.max() < 9.0:
                np.testing.assert_allclose(again, forces, atol=1e-4)
                same += 1
    assert same > 6


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda: PreloadPolicy("dual_newton", -1.0), "preload"),
        (lambda: PreloadPolicy("dual_newton", "2"), "preload"),
        (lambda: ReactivePolicy(smoothing=1.0), "smoothing"),
        (lambda: ReactivePolicy(stiffness=np.nan), "stiffness"),
        (lambda: ReactivePolicy(3), "solver"),
    ],
)
def test_bad_arguments_of_policies_are_named(call, named) -> None:
    with pytest.raises(EnvironmentSettingsError, match=named):
        call()


def test_cone_actions_lie_in_the_cones(make) -> None:
    env = ConeActions(make(STATIC))
    rng = seeded(0)
    for seed in range(10):
        observation, _ = env.reset(seed=reseeded(seed))
        problem = GraspForceProblem(**unpack(observation))
        forces = env.forces(rng.uniform(-1.5, 1.5, 24))
        assert residuals.friction_violation(problem, forces) < 1e-6
        assert not forces.reshape(8, 3)[observation["contact_mask"] == 0].any()
        squeeze = env.forces(np.zeros(24)).reshape(8, 3)[observation["contact_mask"] > 0]
        expected = np.tile([0.0, 0.0, observation["normal_min"][0] + 1.25], (len(squeeze), 1))
        np.testing.assert_allclose(squeeze, expected)


def test_corrections_stay_balanced(make) -> None:
    env = make(STATIC, push=0.0, twist=0.0, mass_range=(0.1, 0.15))
    planner = Planner("dual_newton")
    rng = seeded(0)
    exact = 0
    for seed in range(20):
        observation, _ = env.reset(seed=reseeded(seed))
        change = rng.normal(size=6) * [1, 1, 1, 0.01, 0.01, 0.01]
        forces = 20.0 * planner.action(observation, change, 1.0).astype(np.float64)
        fields = unpack(observation)
        asked = fields | {"external_wrench": fields["external_wrench"] + change}
        problem = GraspForceProblem(**asked)
        if residuals.equilibrium_residual(problem, forces) < 1e-4:
            exact += 1
            assert residuals.friction_violation(problem, forces) < 1e-5
            normal = forces.reshape(8, 3)[fields["contact_mask"] > 0, 2]
            assert normal.min() > 3.0 - 1e-5
    assert exact > 10


def test_an_impossible_correction_falls_back_on_the_solver(make) -> None:
    observation, _ = make(STATIC).reset(seed=reseeded(0))
    planner = Planner("dual_newton")
    expected = planner.policy.predict(observation)[0]
    answer = planner.action(observation, np.full(6, 1e4), 0.0)
    np.testing.assert_array_equal(answer, expected)


def test_features_measure_the_push(make) -> None:
    """At rest the contacts carry weight and push: what is felt beyond the weight is the push."""
    env = ResidualWrench(
        make(FELT, twist=0.0, turn=0.0, mass_change=(1, 1), friction_change=(1, 1))
    )
    features = LoadFeatures(env)
    errors = []
    for seed in range(6):
        observation, _ = features.reset(seed=reseeded(seed))
        assert observation in features.observation_space
        for _ in range(11):
            observation, _, terminated, _, _ = features.step(np.zeros(7, np.float32))
            if terminated:
                break
        else:
            seen = env._observation
            push = -measured_wrench(seen) - seen["external_wrench"]
            errors.append(abs(np.linalg.norm(push[:3]) - 2.0))
    assert len(errors) > 1
    assert np.median(errors) < 1.0


def test_reactive_policy_answers_what_it_feels(make) -> None:
    policy, env = ReactivePolicy(), make(FELT)
    other = 0
    for seed in range(1, 5):
        observation, _ = env.reset(seed=reseeded(seed))
        action, state = policy.predict(observation)
        raised = policy.planner.action(observation, np.zeros(6), policy.preload)
        np.testing.assert_array_equal(action, raised)
        observation, *_ = env.step(action)
        later, state = policy.predict(observation, state)
        assert state is not None
        other += not np.array_equal(later, policy.predict(observation)[0])
    assert other >= 2  # where no forces carry the load, both are the same squeeze
    announced, _ = make(DYNAMIC).reset(seed=reseeded(1))
    assert policy.predict(announced)[1] is None


# -- network ---------------------------------------------------------------------------------------


def test_contact_network_knows_no_order_and_no_frame(make) -> None:
    env = make(STATIC)
    space = env.observation_space
    assert isinstance(space, spaces.Dict)
    torch.manual_seed(reseeded(0))
    network = ContactExtractor(space)
    head = ContactHead(8, network.features_dim // 8, gain=1.0)
    observation, _ = env.reset(seed=reseeded(0))
    fields = unpack(observation)
    order = seeded(0).permutation(8)
    columns = (3 * order[:, None] + np.arange(3)).reshape(-1)
    turn = np.linalg.qr(seeded(1).normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    both = np.kron(np.eye(2), turn)
    moved = dict(fields)
    for name in ("friction", "normal_min", "normal_max", "contact_mask"):
        moved[name] = fields[name][order]
    moved["grasp_map"] = both @ fields["grasp_map"][:, columns]
    moved["hand_jacobian"] = fields["hand_jacobian"][columns]
    moved["external_wrench"] = both @ fields["external_wrench"]

    def answer(values: dict[str, Any]) -> np.ndarray:
        batch = {
            name: torch.as_tensor(np.ravel(value), dtype=torch.float32)[None]
            for name, value in values.items()
        }
        with torch.no_grad():
            return head(network(batch)).numpy()[0]

    np.testing.assert_allclose(answer(moved), answer(fields)[columns], atol=1e-5)


@pytest.mark.parametrize("algo", ["ppo", "sac"])
@pytest.mark.parametrize("network", ["mlp", "contacts"])
def test_every_network_trains(settings, algo, network) -> None:
    run = settings(algo, steps=128, hyperparams=(*SMALL[algo], f"network:{network}"))
    assert np.isfinite(train_rl(run).reward)
    assert load_agent(run.output).parameters.network == network


def test_reactions_turn_as_what_they_react_to() -> None:
    """Vectors that are turned get corrections that are turned, and the same preload."""
    rng = seeded(0)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    one = {
        "vectors": rng.normal(size=(1, 3, 4, 6)).astype(np.float32),
        "scalars": rng.normal(size=(1, 3, 5)).astype(np.float32),
    }
    both = np.kron(np.eye(2), turn)
    other = one | {"vectors": (one["vectors"] @ both.T).astype(np.float32)}
    space = spaces.Dict(
        {name: spaces.Box(-np.inf, np.inf, array.shape[1:]) for name, array in one.items()}
    )
    policy = ReactionActorCritic(space, spaces.Box(-1.0, 1.0, (7,)), lambda _: 1e-3)
    assert not policy.predict(one, deterministic=True)[0].any()
    torch.manual_seed(reseeded(0))
    with torch.no_grad():
        for weight in policy.action_net.parameters():
            weight += 0.05 * torch.randn_like(weight)
    before, after = (policy.predict(each, deterministic=True)[0][0] for each in (one, other))
    assert 0.01 < np.abs(before[:6]).max() < 1.0
    np.testing.assert_allclose(after[:6], both @ before[:6], atol=1e-5)
    assert after[6] == pytest.approx(before[6], abs=1e-5)
    assert abs(before[6]) > 1e-3


# -- settings and errors ---------------------------------------------------------------------------


def test_every_section_of_hyperparameters_is_there() -> None:
    for algo in SMALL:
        for situation in ("static", "dynamic", "preloads", "residual", "residual_forces"):
            assert hyperparameters(algo, situation, {}).algorithm["gamma"] >= 0.0
    changed = hyperparameters("ppo", "static", {"policy_kwargs": {"net_arch": [8]}, "n_steps": 7})
    assert changed.algorithm["policy_kwargs"]["net_arch"] == [8]
    assert "log_std_init" in changed.algorithm["policy_kwargs"]
    assert changed.algorithm["n_steps"] == 7


def test_key_values() -> None:
    assert key_values(("push:3.0", "mode:static", "mass_range:[0.1, 0.2]", "announced:false")) == {
        "push": 3.0,
        "mode": "static",
        "mass_range": [0.1, 0.2],
        "announced": False,
    }


def test_settings_survive_their_file(settings) -> None:
    run = settings("sac")
    run.output.mkdir()
    run.save()
    assert RlSettings.load(run.output) == run


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--env", "NoSuch-v0"), "NoSuch"),
        (("--env", "CartPole-v1"), "CartPole-v1 is not"),
        (("--env-kwargs", "push"), "'push' is not of the form key:value"),
        (("--env-kwargs", "nosuch:1"), "nosuch"),
        (("--env-kwargs", "push:-1"), "push must be"),
        (("--hyperparams", "nosuch:1"), "nosuch"),
        (("--hyperparams", "network:nosuch"), "network is 'nosuch'"),
        (("--solver", "nosuch", "--policy", "residual"), "unknown solver 'nosuch'"),
        (("--steps", "0"), "steps is 0"),
        (("--seed", "-1"), "seed is -1"),
        (("--envs", "0"), "envs is 0"),
    ],
)
def test_bad_input_is_one_clear_line(arguments, message, tmp_path) -> None:
    done = run_command("train_rl", "--output", tmp_path / "run", *arguments)
    assert_one_clear_line(done, message)
