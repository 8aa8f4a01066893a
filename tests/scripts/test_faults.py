"""Commands that are killed end, once they are begun again, like those that were not.

So do those that were interrupted, or ran out of room on the disk. `make faults` takes all commands
and kills each of them ten times on its way.
"""

import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.support.faults import MANY, Command, moments

pytestmark = pytest.mark.slow

NETWORK = (
    *("--grasps", "grasps.npz", "--output", "run", "--steps", 24, "--batch", 32),
    *("--validate-every", 3, "--validation-share", 0.3, "--network.steps", 2, "--network.width", 8),
)
AGENT = (
    *("--output", "run", "--env", "GraspForceStatic-v0", "--steps", 192, "--envs", 2),
    *("--evaluate-every", 64, "--evaluation-episodes", 2, "--checkpoint-every", 64),
    *("--env-kwargs", "split:test", "grasps:grasps.npz", "--evaluation-kwargs", "split:test"),
)
SMALL = ("learning_starts:40", "batch_size:16", "buffer_size:500")

Content = dict[str, bytes]


@dataclass(frozen=True)
class Case:
    """A command, and what is to be the same in the end.

    Args:
        script: its name.
        arguments: whose paths are below the folder that it runs in.
        begun: what is there once it is at work.
        results: reads what it made.
    """

    script: str
    arguments: tuple[object, ...]
    begun: str
    results: Callable[[Path], Content]


def files(*names: str) -> Callable[[Path], Content]:
    return lambda folder: {name: (folder / name).read_bytes() for name in names}


def agent(folder: Path) -> Content:
    """What an agent's run has made; its zip tells the time, too, outside the parameters."""
    names = ("agent.npz", "evaluations.npz", "hyperparameters.json", "settings.json")
    (checkpoint,) = (folder / "run").glob("checkpoint_*")
    paths = [*(folder / "run" / name for name in names), *checkpoint.iterdir()]
    found = {
        str(path.relative_to(folder)): path.read_bytes() for path in paths if path.suffix != ".zip"
    }
    for path in (folder / "run" / "model.zip", checkpoint / "model.zip"):
        with zipfile.ZipFile(path) as archive:
            for name in archive.namelist():
                if name.endswith(".pth"):
                    found[f"{path.relative_to(folder)}/{name}"] = archive.read(name)
    return found


CASES = {
    "collect": Case(
        "collect",
        ("--output", "grasps.npz", "--grasps", 60, "--split", "test", "--workers", 2),
        "grasps.npz.parts",
        files("grasps.npz"),
    ),
    "train": Case(
        "train",
        NETWORK,
        "run",
        files("run/conditioned.safetensors", "run/history.json", "run/checkpoint.pt"),
    ),
    "train_quality": Case(
        "train_quality",
        NETWORK,
        "run",
        files("run/quality.safetensors", "run/history.json", "run/checkpoint.pt"),
    ),
    "ppo": Case(
        "train_rl",
        (*AGENT, "--hyperparams", "n_steps:16", "batch_size:32", "n_epochs:2"),
        "run/settings.json",
        agent,
    ),
    "sac": Case(
        "train_rl", (*AGENT, "--algo", "sac", "--hyperparams", *SMALL), "run/settings.json", agent
    ),
}


def start(folder: Path, case: Case, **limits: int) -> Command:
    return Command(folder, case.script, *case.arguments, **limits)


@pytest.fixture(scope="module")
def grasps(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("grasps")
    assert start(folder, CASES["collect"]).end()[0] == 0
    return folder / "grasps.npz"


@pytest.fixture(scope="module")
def whole(
    grasps, tmp_path_factory: pytest.TempPathFactory
) -> Callable[[str], tuple[Content, float]]:
    """What a command makes that nothing disturbs, and how long that takes."""
    known: dict[str, tuple[Content, float]] = {}

    def run(name: str) -> tuple[Content, float]:
        if name not in known:
            folder = prepared(tmp_path_factory.mktemp(name), name, grasps)
            status, complaints, took = start(folder, CASES[name]).end()
            assert status == 0, complaints
            known[name] = CASES[name].results(folder), took
        return known[name]

    return run


def prepared(folder: Path, name: str, grasps: Path) -> Path:
    """The folder, with the grasps that all but one begin with."""
    if name != "collect":
        (folder / "grasps.npz").write_bytes(grasps.read_bytes())
    return folder


@pytest.mark.parametrize("name", CASES if MANY else ("collect", "train", "ppo"))
def test_whatever_happens_on_the_way_the_end_is_the_same(name, grasps, whole, tmp_path) -> None:
    expected, took = whole(name)
    case, folder = CASES[name], prepared(tmp_path, name, grasps)

    processes = ("--vector", "subproc") if case.script == "train_rl" else ()
    command = Command(folder, case.script, *case.arguments, *processes)
    command.wait_for(folder / case.begun)
    assert command.interrupt() == (130, ["interrupted"])

    status, complaints, _ = start(folder, case, limit=4).end()
    assert (status, len(complaints)) == (2, 1), complaints
    assert complaints[0].startswith("error: cannot write ")
    assert "ulimit -f" in complaints[0]

    for moment in moments(len(name), took):
        start(folder, case).kill(moment)

    status, complaints, _ = start(folder, case).end()
    assert status == 0, complaints
    made = case.results(folder)
    assert made.keys() == expected.keys()
    assert [name for name in expected if made[name] != expected[name]] == []
