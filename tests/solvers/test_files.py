"""Files of state: whole or not at all, and whatever is wrong with one is one clear error."""

import io
import json
import os
import pickle
import resource
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from solvers.exceptions import GraspForceError, UnreadableFileError, UnwritableFileError
from solvers.files import (
    check_archive,
    read_arrays,
    read_bytes,
    read_json,
    reading,
    write_arrays,
    write_atomically,
    write_json,
)
from tests.support.seeds import seeded

ARRAYS = {
    "header": np.array(json.dumps({"format": "some"})),
    "numbers": np.linspace(0.0, 1.0, 60).reshape(3, 4, 5),
    "columns": np.asfortranarray(np.arange(12.0).reshape(3, 4)),
    "names": np.array(["one", "three"]),
    "none": np.zeros((0, 7)),
    "mask": np.array([True, False]),
}


@contextmanager
def largest_file(length: int) -> Iterator[None]:
    """No file can become longer, as on a disk that is full."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (length, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def zipped(members: dict[str, bytes], *, compressed: bool = True) -> bytes:
    content = io.BytesIO()
    method = zipfile.ZIP_DEFLATED if compressed else zipfile.ZIP_STORED
    with zipfile.ZipFile(content, "w", method) as archive:
        for name, member in members.items():
            archive.writestr(name, member)
    return content.getvalue()


def npy(array: np.ndarray, **changes: object) -> bytes:
    """A .npy file, its header changed."""
    content = io.BytesIO()
    header = {"descr": "<f8", "fortran_order": False, "shape": array.shape} | changes
    np.lib.format.write_array_header_1_0(content, header)
    return content.getvalue() + array.tobytes()


def assert_same(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> None:
    assert one.keys() == other.keys()
    for name, array in one.items():
        assert array.dtype == other[name].dtype
        np.testing.assert_array_equal(array, other[name], err_msg=name)


# -- writing ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("compressed", [False, True])
def test_arrays_come_back_bit_for_bit_and_give_the_same_bytes(tmp_path, compressed) -> None:
    one, other = tmp_path / "deep" / "er" / "one.npz", tmp_path / "other.npz"
    write_arrays(one, ARRAYS, compressed=compressed)
    write_arrays(other, ARRAYS, compressed=compressed)
    back = read_arrays(one)
    assert_same(back, ARRAYS)
    assert back["numbers"].flags.writeable
    assert one.read_bytes() == other.read_bytes()


def test_what_fails_half_way_leaves_what_was_there(tmp_path) -> None:
    path = tmp_path / "state.json"
    write_json(path, [1, 2])
    before = path.read_bytes()

    def fail(stream) -> None:
        stream.write(b"half")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_atomically(path, fail)
    with pytest.raises(TypeError):
        write_json(path, object())
    with largest_file(4096), pytest.raises(UnwritableFileError, match=r"state.json: .*; raise"):
        write_json(path, list(range(9999)))
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["state.json"]


def test_places_where_nothing_can_be_written_are_named(tmp_path) -> None:
    file = tmp_path / "file"
    file.write_text("")
    (tmp_path / "folder").mkdir()
    for path in (file / "state.json", file / "deeper" / "state.json", tmp_path / "folder"):
        with pytest.raises(UnwritableFileError, match=f"cannot write .*{path.parts[-2]}.*; "):
            write_json(path, 1)
    assert sorted(os.listdir(tmp_path)) == ["file", "folder"]
    # who takes any refusal of the system alike need not know of this one
    assert issubclass(UnwritableFileError, OSError)
    assert issubclass(UnwritableFileError, GraspForceError)


# -- reading ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("compressed", [False, True])
def test_damaged_arrays_are_refused_or_the_same(tmp_path, compressed) -> None:
    path = tmp_path / "state.npz"
    write_arrays(path, ARRAYS, compressed=compressed)
    content = path.read_bytes()
    rng = seeded(0)
    for length in rng.integers(len(content), size=100):
        path.write_bytes(content[:length])
        with pytest.raises(UnreadableFileError, match=r"state\.npz cannot be read"):
            read_arrays(path)
    refused = 0
    for bit in rng.integers(8 * len(content), size=600):
        flipped = bytearray(content)
        flipped[bit // 8] ^= 1 << (bit % 8)
        path.write_bytes(flipped)
        try:
            back = read_arrays(path)
        except UnreadableFileError:
            refused += 1
        else:  # a date, or the like; or the name of an array, which its reader will miss
            for name in back.keys() & ARRAYS.keys():
                np.testing.assert_array_equal(back[name], ARRAYS[name])
    assert refused > 150


class Trap:
    """What must never be called."""

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return os.mkdir, ("sprung",)


STRANGE = {
    "empty": b"",
    "text": b"hello",
    "pickle": pickle.dumps(Trap()),
    "array": npy(np.zeros(3)),
    "no arrays": zipped({"a.txt": b"hello"}),
    "pickled array": zipped({"a.npy": b"\x93NUMPY\x01\x00" + pickle.dumps(Trap())}),
    "object": zipped({"a.npy": npy(np.zeros(1), descr="|O") + pickle.dumps(Trap())}),
    "too long a shape": zipped({"a.npy": npy(np.zeros(3), shape=(10**15,))}),
    "negative": zipped({"a.npy": npy(np.zeros(4), shape=(-2, -2))}),
    "no type": zipped({"a.npy": npy(np.zeros(3), descr="strange")}),
    "nested": zipped({"a.npy": b"\x93NUMPY\x01\x00\xff\x0f" + b"[" * 4095}),
    "later version": zipped({"a.npy": b"\x93NUMPY\x09\x00" + bytes(200)}),
    "longer": zipped({"a.npy": npy(np.zeros(3)) + bytes(8)}),
    "bomb": zipped({"a.npy": npy(np.zeros(1 << 24))}),
}


@pytest.mark.parametrize("kind", STRANGE)
def test_strange_files_are_refused_without_harm(tmp_path, monkeypatch, kind) -> None:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "state.npz"
    path.write_bytes(STRANGE[kind])
    with pytest.raises(UnreadableFileError, match=r"state\.npz cannot be read: \S"):
        read_arrays(path)
    assert os.listdir(tmp_path) == ["state.npz"]


def test_what_is_no_file_is_refused(tmp_path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path, tmp_path / "pipe", Path("/dev/zero")):
        for read in (read_arrays, read_json, read_bytes):
            with pytest.raises(UnreadableFileError, match=f"{path} is not a file"):
                read(path)
    with pytest.raises(FileNotFoundError):
        read_arrays(tmp_path / "missing")
    (tmp_path / "file").write_text("")
    with pytest.raises(UnreadableFileError):
        read_json(tmp_path / "file" / "below")


@pytest.mark.parametrize("content", [b"", b"{", b"\xff\xfe", b"[" * 100_000, b"1" * 9999])
def test_text_that_is_no_json_is_refused(tmp_path, content) -> None:
    path = tmp_path / "state.json"
    path.write_bytes(content)
    with pytest.raises(UnreadableFileError, match=r"state\.json cannot be read"):
        read_json(path)


def test_long_texts_are_refused(tmp_path) -> None:
    path = tmp_path / "state.json"
    write_json(path, [0.1, float("inf"), "ä"])
    assert read_json(path) == [0.1, float("inf"), "ä"]
    with pytest.raises(UnreadableFileError, match="longer than 5"):
        read_bytes(path, 5)


def test_archives_in_archives_are_looked_into(tmp_path) -> None:
    whole = zipped({"a": bytes(range(256)), "b": b""}, compressed=False)
    bomb = zipped({"a": bytes(80 << 20)})
    path = tmp_path / "model.zip"
    inner = zipped({"inner.pth": whole, "data": b"text"}, compressed=False)
    path.write_bytes(inner)
    with reading(path) as stream:
        check_archive(stream)
        assert stream.read() == inner
    damaged = bytearray(inner)
    damaged[inner.index(bytes(range(9))) + 3] ^= 1
    for content in (bomb, zipped({"inner.pth": bomb}), bytes(damaged)):
        path.write_bytes(content)
        with pytest.raises(UnreadableFileError), reading(path) as stream:
            check_archive(stream)
