"""What an import costs, what works without a simulator, and what the built wheel holds."""

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("gfo_env", "solvers", "training")

# What a GPU node may lack: the simulator, the meshes, the environments, the RL baselines.
WORLD = ("gymnasium", "pybullet", "pybullet_data", "stable_baselines3", "trimesh")
# The rooms of `training` whose purpose is the world; no other may need it to be loaded.
WORLD_ROOMS = (
    "training.demonstration",
    "training.evaluation.",
    "training.problems.tasks",
    "training.rl.",
    "training.studies.environment.",
    "training.studies.holding.",
    "training.studies.paper.",
    "training.studies.policies.",
    "training.studies.quality.",
)

# What no package loads before it is asked for something that needs it.
HEAVY = {"pybullet", "pybullet_data", "stable_baselines3", "torch"}

LOADED = "import json, sys, {module}; print(json.dumps(sorted(sys.modules)))"

FAILURES = """
import importlib, json, sys

absent, modules = json.loads(sys.argv[1])


class Absent:
    @staticmethod
    def find_spec(name, path=None, target=None):
        if name.partition(".")[0] in absent:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


sys.meta_path.insert(0, Absent)
failures = {}
for module in modules:
    try:
        importlib.import_module(module)
    except Exception as error:
        failures[module] = repr(error)
print(json.dumps(failures))
"""


def run_python(code: str, *arguments: str, path: Path = ROOT) -> str:
    """Run code in a fresh interpreter that finds the packages below `path` first."""
    result = subprocess.run(
        [sys.executable, "-c", code, *arguments],
        cwd=path,
        env=os.environ | {"PYTHONPATH": str(path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    return result.stdout


def package_files(package: str) -> set[str]:
    """Everything that belongs to a package, relative to the repository."""
    return {
        path.relative_to(ROOT).as_posix()
        for path in (ROOT / package).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }


def modules_of(package: str) -> list[str]:
    names = (name for name in package_files(package) if name.endswith(".py"))
    dotted = (name.removesuffix(".py").replace("/", ".") for name in names)
    return sorted(name.removesuffix(".__init__") for name in dotted)


def import_failures(modules: list[str]) -> dict[str, str]:
    """Import the modules where the world is absent; the error of each that needs it."""
    failures: dict[str, str] = json.loads(run_python(FAILURES, json.dumps([WORLD, modules])))
    return failures


@pytest.mark.parametrize(
    ("module", "too_heavy"),
    [
        ("gfo_env", {"clarabel", "numba", "scipy", "trimesh"}),
        ("solvers", {"clarabel", "cvxpy", "gymnasium", "numba", "scipy", "trimesh"}),
    ],
)
def test_import_loads_nothing_heavy(module: str, too_heavy: set[str]) -> None:
    loaded = set(json.loads(run_python(LOADED.format(module=module))))
    assert module in loaded
    assert loaded & (too_heavy | HEAVY) == set()


@pytest.mark.parametrize("package", ["solvers", "training"])
def test_package_imports_where_the_world_is_absent(package: str) -> None:
    modules = modules_of(package)
    assert package in modules
    failures = import_failures(modules)
    surprising = {name: why for name, why in failures.items() if not name.startswith(WORLD_ROOMS)}
    assert surprising == {}


def test_world_is_absent_where_it_is_meant_to_be() -> None:
    assert set(import_failures([*WORLD, "solvers"])) == set(WORLD)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "hatchling", "build", "--target", "wheel"]
    subprocess.run([*build, "--directory", str(folder)], cwd=ROOT, check=True, capture_output=True)
    (path,) = folder.glob("graspforce-*.whl")
    return path


def test_wheel_holds_the_packages_with_their_data_and_nothing_else(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    shipped = {name for name in names if ".dist-info/" not in name}
    assert shipped == set().union(*map(package_files, PACKAGES))
    assert any(name.endswith(".dist-info/licenses/LICENSE") for name in names)


def test_wheel_imports_on_its_own(wheel: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path)
    code = f"import {', '.join(PACKAGES)}; print({', '.join(f'{p}.__file__' for p in PACKAGES)})"
    expected = [str(tmp_path / package / "__init__.py") for package in PACKAGES]
    assert run_python(code, path=tmp_path).split() == expected
