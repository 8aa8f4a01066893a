"""Files that were cut, flipped, exchanged or forged: read rightly, or refused in clear words."""

import io
import json
import pickle
import shutil
import struct
import tempfile
import zipfile
import zlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
import trimesh
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

from gfo_env.cache import cache_folder
from gfo_env.grasps import GraspTable
from gfo_env.hand import HandDescription
from gfo_env.objects import ObjectSet
from solvers import GraspForceProblem, make_solver, solve
from solvers.learned.conditioned import DEFAULT_WEIGHTS
from solvers.max_quality.learned import DEFAULT_QUALITY_WEIGHTS
from tests.fuzz.hands import CLOSING, three_fingers
from tests.fuzz.outcome import WrongAnswer, tell
from tests.support.grasp_tables import random_table
from tests.support.problems import random_problem
from training.networks.checkpoint import resume, save_checkpoint
from training.rl.hyperparameters import Hyperparameters, hyperparameters
from training.rl.runs import learning_curve, load_agent
from training.rl.settings import RlSettings

_TRAP = Path("sprung")
"""Exists once something has been unpickled that should not have been."""

_BOMB = 400
_BLOCK = 16 * 2**20
"""A file of 400 blocks of zeros, 6.7 GB, in 7 MB."""


class _Trap:
    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (_TRAP.absolute(),)


# -- what reads files ------------------------------------------------------------------------------


def _read_problem(path: Path) -> None:
    solve(GraspForceProblem.load(path))


def _read_table(path: Path) -> None:
    table = GraspTable.load(path)
    if not np.isfinite(table.grasp_map).all():
        raise WrongAnswer("a table of grasps with numbers that are none")


def _read_weights(path: Path) -> None:
    solve(random_problem(np.random.default_rng(0)), make_solver("conditioned", weights=path))


def _read_quality_weights(path: Path) -> None:
    make_solver("quality", weights=path)


def _read_mesh(path: Path) -> None:
    folder = Path("set")
    folder.mkdir(exist_ok=True)
    shutil.move(path, folder / path.name)
    try:
        ObjectSet(folder)[path.name]
    finally:
        shutil.rmtree(folder)


def _read_hand(path: Path) -> None:
    HandDescription.from_urdf(path, **CLOSING)


def _run_folder(path: Path, name: str) -> Path:
    """A folder of its own with the run, and one of its files exchanged."""
    folder = Path(f"run_{np.random.default_rng().integers(2**60)}")
    shutil.copytree(_finished_run(), folder)
    shutil.move(path, folder / name)
    return folder


def _reads_run(name: str, read: Callable[[Path], Any]) -> Callable[[Path], None]:
    def reading(path: Path) -> None:
        folder = _run_folder(path, name)
        try:
            read(folder)
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    return reading


def _resume(folder: Path) -> None:
    network = torch.nn.Linear(3, 2)
    resume(folder, "settings", network, torch.optim.Adam(network.parameters()))


def _read_parts(path: Path) -> None:
    """The kept convex parts of a concave body are exchanged: they are made anew."""
    kept = cache_folder("convex_parts")
    for file in kept.glob("*.npz"):
        shutil.copy(path, file)
    folder = Path("concave")
    folder.mkdir(exist_ok=True)
    # a change of time makes the set read the file again
    _ell().export(folder / "ell.stl")
    try:
        body = ObjectSet(folder)["ell.stl"]
    finally:
        shutil.rmtree(folder)
    if sum(part.volume for part in body.parts) < 0.9 * body.volume:
        raise WrongAnswer("convex parts that do not fill the solid")


# -- what they are made of -------------------------------------------------------------------------


@cache
def _bytes_of(kind: str) -> bytes:
    path = Path(f"whole_{kind}")
    _WRITERS[kind](path)
    content = path.read_bytes()
    path.unlink()
    return content


def _write_problem(path: Path) -> None:
    random_problem(np.random.default_rng(1)).save(path)


def _write_table(path: Path) -> None:
    random_table(np.random.default_rng(2), 6).save(path)


def _ell() -> trimesh.Trimesh:
    arms = [trimesh.creation.box((0.1, 0.03, 0.02)), trimesh.creation.box((0.03, 0.02, 0.1))]
    return trimesh.boolean.union(arms)


def _writes_mesh(suffix: str) -> Callable[[Path], None]:
    def write(path: Path) -> None:
        content = trimesh.creation.cylinder(0.03, 0.08, sections=12).export(file_type=suffix)
        path.write_bytes(content.encode() if isinstance(content, str) else content)

    return write


@cache
def _finished_run() -> Path:
    """A finished run of reinforcement learning, as far as it is read."""
    folder = Path(tempfile.mkdtemp(prefix="run_"))
    RlSettings(output=folder).save()
    hyperparameters("ppo", "static", {}).save(folder)
    env = VecNormalize(DummyVecEnv([lambda: gymnasium.make("CartPole-v1")]))
    PPO("MlpPolicy", env, n_steps=8, batch_size=8).save(folder / "model.zip")
    env.save(str(folder / "vecnormalize.pkl"))
    np.savez(
        folder / "evaluations.npz",
        timesteps=np.arange(3),
        results=np.ones((3, 4)),
        ep_lengths=np.ones((3, 4), dtype=int),
    )
    network = torch.nn.Linear(3, 2)
    save_checkpoint(folder, "settings", network, torch.optim.Adam(network.parameters()), 3, [])
    return folder


def _writes_run(name: str) -> Callable[[Path], None]:
    return lambda path: path.write_bytes((_finished_run() / name).read_bytes())  # type: ignore[return-value]


def _write_parts(path: Path) -> None:
    kept = cache_folder("convex_parts")
    if not list(kept.glob("*.npz")):
        folder = Path("concave")
        folder.mkdir()
        _ell().export(folder / "ell.stl")
        ObjectSet(folder)["ell.stl"]
        shutil.rmtree(folder)
    path.write_bytes(next(kept.glob("*.npz")).read_bytes())


_WRITERS: dict[str, Callable[[Path], Any]] = {
    "problem.npz": _write_problem,
    "table.npz": _write_table,
    "conditioned.safetensors": lambda path: path.write_bytes(DEFAULT_WEIGHTS.read_bytes()),
    "quality.safetensors": lambda path: path.write_bytes(DEFAULT_QUALITY_WEIGHTS.read_bytes()),
    **{f"mesh.{suffix}": _writes_mesh(suffix) for suffix in ("stl", "obj", "ply", "off", "glb")},
    "hand.urdf": lambda path: path.write_text(three_fingers()),
    "settings.json": _writes_run("settings.json"),
    "hyperparameters.json": _writes_run("hyperparameters.json"),
    "evaluations.npz": _writes_run("evaluations.npz"),
    "checkpoint.pt": _writes_run("checkpoint.pt"),
    "model.zip": _writes_run("model.zip"),
    "vecnormalize.pkl": _writes_run("vecnormalize.pkl"),
    "parts.npz": _write_parts,
}

_READERS: dict[str, Callable[[Path], None]] = {
    "problem.npz": _read_problem,
    "table.npz": _read_table,
    "conditioned.safetensors": _read_weights,
    "quality.safetensors": _read_quality_weights,
    **{f"mesh.{suffix}": _read_mesh for suffix in ("stl", "obj", "ply", "off", "glb")},
    "hand.urdf": _read_hand,
    "settings.json": _reads_run("settings.json", RlSettings.load),
    "hyperparameters.json": _reads_run("hyperparameters.json", Hyperparameters.load),
    "evaluations.npz": _reads_run("evaluations.npz", learning_curve),
    "checkpoint.pt": _reads_run("checkpoint.pt", _resume),
    "model.zip": _reads_run("model.zip", load_agent),
    "vecnormalize.pkl": _reads_run("vecnormalize.pkl", load_agent),
    "parts.npz": _read_parts,
}

# -- what is done to them --------------------------------------------------------------------------


def _cut(rng: np.random.Generator, content: bytes) -> bytes:
    return content[: rng.integers(len(content))]


def _flipped(rng: np.random.Generator, content: bytes) -> bytes:
    changed = bytearray(content)
    for _ in range(rng.integers(1, 4)):
        changed[rng.integers(len(changed))] ^= 1 << rng.integers(8)
    return bytes(changed)


def _flipped_early(rng: np.random.Generator, content: bytes) -> bytes:
    """Where headers are."""
    changed = bytearray(content)
    changed[rng.integers(min(len(changed), 300))] ^= 1 << rng.integers(8)
    return bytes(changed)


def _overwritten(rng: np.random.Generator, content: bytes) -> bytes:
    start, length = int(rng.integers(len(content))), int(rng.integers(1, 200))
    return content[:start] + rng.bytes(length) + content[start + length :]


def _zeroed_tail(rng: np.random.Generator, content: bytes) -> bytes:
    """What a machine that lost its power leaves."""
    start = int(rng.integers(len(content)))
    return content[:start] + bytes(len(content) - start)


def _nothing(_: np.random.Generator, __: bytes) -> bytes:
    return b""


def _noise(rng: np.random.Generator, _: bytes) -> bytes:
    return rng.bytes(int(rng.integers(1, 2000)))


def _other_version(rng: np.random.Generator, content: bytes) -> bytes:
    number = str(rng.integers(3, 99)).encode()
    for mark in (b"graspforce-problem-", b"graspforce-grasps-", b"-1", b"1.0", b"2.0"):
        if mark in content:
            return content.replace(mark + b"1", mark + number).replace(mark, mark[:-1] + b"9")
    return content[:4] + number + content[4:]


def _exchanged(rng: np.random.Generator, _: bytes) -> bytes:
    """Another kind of file by that name."""
    return _bytes_of(str(rng.choice(list(_WRITERS))))


def _pickle(_: np.random.Generator, __: bytes) -> bytes:
    return pickle.dumps(_Trap())


def _pickled_members(_: np.random.Generator, content: bytes) -> bytes:
    """Every member of an archive, or the only array, holds objects."""
    stream = io.BytesIO()
    np.save(stream, np.array([_Trap()], dtype=object), allow_pickle=True)
    return _members(content, lambda _: stream.getvalue()) or stream.getvalue()


def _members(content: bytes, change: Callable[[bytes], bytes]) -> bytes:
    """The archive with all its members changed; nothing where it is none."""
    if not zipfile.is_zipfile(io.BytesIO(content)):
        return b""
    stream = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as old, zipfile.ZipFile(stream, "w") as new:
        for name in old.namelist():
            new.writestr(name, change(old.read(name)))
    return stream.getvalue()


def _claimed(size: int) -> bytes:
    """The beginning of an array of so many numbers."""
    header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': ({size},), }}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header.encode()


def _lying(rng: np.random.Generator, content: bytes) -> bytes:
    """Arrays that say that they are larger than any memory."""
    claim = _claimed(int(rng.choice([2**34, 2**60, 10**30])))
    return _members(content, lambda _: claim + bytes(64)) or claim


@cache
def _zeros() -> bytes:
    """Deflated blocks of zeros, without the end."""
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    return packer.compress(bytes(_BLOCK)) + packer.flush(zlib.Z_FULL_FLUSH)


def _bomb(_: np.random.Generator, content: bytes) -> bytes:
    """An archive whose members unfold to gigabytes."""
    names = ["header.npy"]
    if zipfile.is_zipfile(io.BytesIO(content)):
        with zipfile.ZipFile(io.BytesIO(content)) as old:
            names = old.namelist()
    start = _claimed(_BOMB * _BLOCK // 8)
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    beginning = packer.compress(start) + packer.flush(zlib.Z_FULL_FLUSH)
    packed = beginning + _zeros() * _BOMB + zlib.compressobj(9, zlib.DEFLATED, -15).flush()
    size = len(start) + _BOMB * _BLOCK
    result, directory = bytearray(), bytearray()
    wide = struct.pack("<HHQQ", 1, 16, size, len(packed))
    for name in names[:1]:
        local = (20, 0, 8, 0, 33, 0, 0xFFFFFFFF, 0xFFFFFFFF, len(name), len(wide))
        place = len(result)
        result += b"PK\x03\x04" + struct.pack("<5H3I2H", *local) + name.encode() + wide + packed
        directory += b"PK\x01\x02" + struct.pack("<H", 45) + struct.pack("<5H3I2H", *local)
        directory += struct.pack("<3H2I", 0, 0, 0, 0, place) + name.encode() + wide
    end = struct.pack("<4H2IH", 0, 0, 1, 1, len(directory), len(result), 0)
    return bytes(result + directory + b"PK\x05\x06" + end)


def _other_json(rng: np.random.Generator, content: bytes) -> bytes:
    """Another value, or none, in the place of one of a JSON file; or one that is nested deeply."""
    try:
        values = json.loads(content)
    except ValueError:
        return b'{"a": 1}'
    if not isinstance(values, dict) or rng.random() < 0.2:
        forms = (b"[1, 2]", b"null", b"3", b'"x"', b"[" * 100_000, b'{"a": NaN}', b"\xff\xfe{}")
        return forms[rng.integers(len(forms))]
    key = str(rng.choice(list(values)))
    others = (None, -1, 1e999, "x", [], {}, [[1]], 2**80, True, "\ud800")
    if rng.random() < 0.2:
        del values[key]
    elif rng.random() < 0.2:
        values["another"] = 1
    else:
        values[key] = others[rng.integers(len(others))]
    return json.dumps(values).encode()


Damage = Callable[[np.random.Generator, bytes], bytes]

DAMAGES: tuple[Damage, ...] = (
    *(_cut, _cut, _flipped, _flipped, _flipped_early, _flipped_early, _overwritten),
    *(_zeroed_tail, _nothing, _noise, _other_version, _exchanged, _pickle, _pickled_members),
    *(_lying, _bomb, _other_json),
)

BOMB = _bomb
"""Takes gigabytes where nothing limits them."""

KINDS = tuple(_WRITERS)
SLOW = ("conditioned.safetensors", "quality.safetensors", "model.zip", "parts.npz")
"""Kinds of files that take a second and more to be read many times."""


def prepare() -> None:
    """Write and read every kind of file once, whole."""
    for kind in _WRITERS:
        path = Path(kind)
        path.write_bytes(_bytes_of(kind))
        _READERS[kind](path)


def try_file(rng: np.random.Generator) -> str:
    """A file of some kind, damaged in some way."""
    kind = str(rng.choice(list(_WRITERS)))
    damage = DAMAGES[rng.integers(len(DAMAGES))]
    if kind.endswith(".json") and rng.random() < 0.5:
        damage = _other_json
    tell(f"{kind}, {damage.__name__.strip('_')}")
    return damaged(kind, damage, rng)


def damaged(kind: str, damage: Damage, rng: np.random.Generator) -> str:
    """Read a damaged file of some kind, in the working folder."""
    path = Path(kind)
    path.write_bytes(damage(rng, _bytes_of(kind)))
    try:
        _READERS[kind](path)
    finally:
        path.unlink(missing_ok=True)
        if _TRAP.exists():
            _TRAP.unlink()
            raise WrongAnswer("what a file holds was unpickled")
    return "read"
