"""The command line: help, bad input in one line, and each command end to end."""

import json
import subprocess
import sys

import numpy as np
import pytest
from PIL import Image

from gfo_env.grasps import GraspTable
from tests.support.commands import ROOT, assert_one_clear_line, run_command

NO_JOBS = {"licences"}
"""Scripts without options."""

COMMANDS = sorted({path.stem for path in (ROOT / "scripts").glob("[a-z]*.py")} - NO_JOBS)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_explains_every_option_without_heavy_imports(command) -> None:
    done = run_command(command, "--help")
    assert done.returncode == 0
    assert "--seed" in done.stdout
    assert "--json" in done.stdout
    slow = [
        sys.executable,
        "-c",
        f"import sys, runpy; sys.argv = ['x', '--help']\n"
        f"try: runpy.run_path('scripts/{command}.py', run_name='__main__')\n"
        "except SystemExit: pass\n"
        "print([m for m in ('torch', 'pybullet', 'trimesh') if m in sys.modules], file=sys.stderr)",
    ]
    loaded = subprocess.run(slow, cwd=ROOT, capture_output=True, text=True, check=True)
    assert loaded.stderr.strip().endswith("[]")


@pytest.mark.parametrize(
    ("command", "arguments", "message"),
    [
        ("collect", ("--output", "x.npz", "--objects", "no/such/folder"), "no/such/folder"),
        ("collect", ("--output", "x.npz", "--split", "nosuch"), "nosuch"),
        ("evaluate", ("--solvers", "nosuch"), "unknown solver 'nosuch'"),
        ("benchmark", ("--grasps", 0), "grasps is 0"),
        ("benchmark", ("--table", "no_such.npz"), "no_such.npz"),
        ("benchmark", ("--page", "tests"), "tests is a folder"),
        ("evaluate", ("--objects", "no/such/folder"), "no/such/folder"),
        ("collect", ("--output", "x.npz", "--grasps", 0), "grasps is 0"),
        ("collect", ("--output", "x.npz", "--workers", 0), "workers is 0"),
        ("collect", ("--output", "x.npz", "--seed", -1), "seed is -1"),
        ("collect", ("--output", "tests"), "tests is a folder"),
        ("collect", ("--output", "README.md/x.npz"), "README.md"),
        ("collect", ("--output", "x.npz", "--json", "tests"), "tests is a folder"),
        ("evaluate", ("--json", "README.md/x.json"), "README.md"),
        ("evaluate", ("--seed", -1, "--solvers", "clarabel"), "seed is -1"),
        ("demo", ("--grasps", 0), "grasps must be 1 or more"),
        ("demo", ("--picture", "README.md/x.png"), "README.md"),
        ("reproduce_paper", ("--grasps", 0), "grasps is 0"),
        ("reproduce_paper", ("--objects", 1000), "objects is 1000"),
        ("reproduce_paper", ("--page", "tests"), "tests is a folder"),
        ("train", ("--grasps", "no_such.npz", "--output", "x"), "no_such.npz"),
    ],
)
def test_bad_input_is_one_clear_line(command, arguments, message, tmp_path) -> None:
    done = run_command(command, *arguments)
    assert_one_clear_line(done, message)
    assert not (ROOT / "x.npz").exists()


def test_mesh_without_faces_is_one_clear_line(tmp_path) -> None:
    (tmp_path / "empty.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\n")
    done = run_command(
        "collect", "--output", tmp_path / "x.npz", "--objects", tmp_path, "--workers", 1
    )
    assert_one_clear_line(done, "empty.obj")


@pytest.mark.slow
def test_collect_writes_the_grasps_and_its_report(tmp_path) -> None:
    arguments = ("--split", "test", "--grasps", 30, "--workers", 2, "--seed", 5)
    done = run_command(
        "collect", "--output", tmp_path / "a.npz", *arguments, "--json", tmp_path / "r.json"
    )
    assert done.returncode == 0, done.stderr
    assert "30 grasps" in done.stdout
    assert len(GraspTable.load(tmp_path / "a.npz")) == 30
    report = json.loads((tmp_path / "r.json").read_text())
    assert report["grasps"] == 30
    assert 0 < report["yield"] <= 1


@pytest.mark.slow
def test_evaluate_compares_the_network_with_the_rest(tmp_path) -> None:
    done = run_command("evaluate", "--grasps", 10, "--json", tmp_path / "rows.json")
    assert done.returncode == 0, done.stderr
    assert "conditioned" in done.stdout
    rows = {row["solver"]: row for row in json.loads((tmp_path / "rows.json").read_text())}
    assert rows["clarabel"]["feasible_rate"] == 1.0
    assert rows["conditioned"]["feasible_rate"] > 0.5
    assert rows["pseudoinverse"]["feasible_rate"] < 0.5


@pytest.mark.slow
def test_evaluate_takes_a_folder_of_meshes(tmp_path) -> None:
    import trimesh

    meshes = tmp_path / "meshes"
    meshes.mkdir()
    trimesh.creation.icosphere(radius=1.0).export(meshes / "ball.stl")
    trimesh.creation.box((1.0, 1.5, 2.0)).export(meshes / "box.ply")
    done = run_command(
        "evaluate",
        "--objects", meshes,
        "--target-size", 0.08,
        "--grasps", 6,
        "--solvers", "clarabel",
        "--json", tmp_path / "rows.json",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    rows = json.loads((tmp_path / "rows.json").read_text())
    assert rows[0]["objects"] == 2
    assert rows[0]["split"] == "all"


@pytest.mark.slow
def test_demo_draws_its_picture(tmp_path) -> None:
    picture = tmp_path / "demo.png"
    done = run_command(
        "demo", "--grasps", 2, "--picture", picture, "--json", tmp_path / "demo.json"
    )
    assert done.returncode == 0, done.stderr
    assert str(picture) in done.stdout.replace("\n", "")
    pixels = np.asarray(Image.open(picture).convert("RGB"))
    assert pixels.shape[0] > 400
    assert len(np.unique(pixels.reshape(-1, 3), axis=0)) > 50
    rows = json.loads((tmp_path / "demo.json").read_text())
    assert {row["solver"] for row in rows} == {"exact", "network"}
    assert all(row["status"] == "optimal" for row in rows if row["solver"] == "exact")
