"""Files that outlive a process: written whole or not at all, and read as data, never as code.

All that the project keeps goes through here: problems, tables of grasps, weights, checkpoints,
settings, results, caches. A reader meets files that a kill cut short, a bad disk changed, or a
stranger made. It unpickles nothing, takes up no more memory than a file of that length can
honestly hold, and has one error for whatever is wrong.
"""

import errno
import io
import json
import os
import secrets
import stat
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from solvers.exceptions import UnreadableFileError, UnwritableFileError

_FREE = 64 << 20
"""Bytes that any archive may unpack to."""
_RATIO = 100
"""Times its own length that a longer one may unpack to: grasps shrink to a third, and a column of
zeros to a thousandth."""

_LONGEST_TEXT = 64 << 20
"""Bytes of the longest JSON that is read."""

_CURES = {
    errno.ENOSPC: "free some space, or choose another place",
    errno.EDQUOT: "free some space, or choose another place",
    errno.EFBIG: "raise the limit on the size of files (ulimit -f)",
    errno.ENOTDIR: "a part of the path is a file; choose another place",
    errno.EEXIST: "a part of the path is a file; choose another place",
    errno.EISDIR: "name a file, not a folder",
    errno.EACCES: "choose a place where you may write",
    errno.EPERM: "choose a place where you may write",
    errno.EROFS: "choose a place where you may write",
}


# -- writing ---------------------------------------------------------------------------------------


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Raise `UnwritableFileError` with cause and cure for what the system refuses inside.

    Args:
        path: of the file or folder that is to be written.
    """
    try:
        yield
    except UnwritableFileError:
        raise
    except OSError as error:
        cure = _CURES.get(error.errno or 0, "choose another place")
        raise UnwritableFileError(
            f"cannot write {path}: {error.strerror or error}; {cure}"
        ) from error


def make_folder(path: Path) -> None:
    """Make a folder, and those above it, if there is none.

    Raises:
        UnwritableFileError: if the system refuses.
    """
    with writing(path):
        path.mkdir(parents=True, exist_ok=True)


def write_atomically(path: Path, write: Callable[[IO[bytes]], Any]) -> None:
    """Write a file whole or not at all, while others may read or write the same one.

    Neither a kill nor the end of the machine's power leaves half of it under its name.

    Args:
        path: of the file; its folder is made if there is none.
        write: puts the content into a stream.

    Raises:
        UnwritableFileError: if the system refuses; what lay there before still does.
    """
    partial = path.with_name(f"{path.name}.{os.getpid()}-{secrets.token_hex(4)}.partial")
    make_folder(path.parent)
    with writing(path):
        try:
            with partial.open("xb") as stream:
                write(stream)
                stream.flush()
                os.fsync(stream.fileno())
            os.replace(partial, path)
        finally:
            partial.unlink(missing_ok=True)


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file whole or not at all, see `write_atomically`."""
    write_atomically(path, lambda stream: stream.write(content))


def write_text(path: Path, text: str) -> None:
    """Write a text in UTF-8, whole or not at all, see `write_atomically`."""
    write_bytes(path, text.encode())


def write_json(path: Path, values: Any, *, indent: int | None = 2, sort_keys: bool = False) -> None:
    """Write values as JSON, whole or not at all, see `write_atomically`."""
    write_text(path, json.dumps(values, indent=indent, sort_keys=sort_keys) + "\n")


def write_arrays(path: Path, arrays: Mapping[str, Any], *, compressed: bool = False) -> None:
    """Write arrays as .npz, whole or not at all; the same arrays give the same bytes.

    Args:
        path: of the file.
        arrays: by name; none of Python objects.
        compressed: whether it takes longer and becomes smaller.
    """
    save = np.savez_compressed if compressed else np.savez
    write_atomically(path, lambda stream: save(stream, allow_pickle=False, **arrays))


# -- reading ---------------------------------------------------------------------------------------


@contextmanager
def reading(path: Path) -> Iterator[IO[bytes]]:
    """A file to read from; whatever goes wrong in the content raises `UnreadableFileError`.

    Raises:
        FileNotFoundError: if there is none.
        UnreadableFileError: if it is no regular file, may not be read, or is not what the reader
            expects.
    """
    try:
        # devices and pipes have no end, or wait for one who writes
        if not stat.S_ISREG(path.stat().st_mode):
            raise UnreadableFileError(f"{path} is not a file that can be read")
        with path.open("rb") as stream:
            yield stream
    except (FileNotFoundError, UnreadableFileError):
        raise
    # there is no end to what libraries raise for content that none of them expects
    except Exception as error:
        raise UnreadableFileError(f"{path} cannot be read: {_reason(error)}") from error


def read_bytes(path: Path, longest: int = _LONGEST_TEXT) -> bytes:
    """The content of a file of at most so many bytes; raises as `reading`."""
    with reading(path) as stream:
        content = stream.read(longest + 1)
        if len(content) > longest:
            raise ValueError(f"it is longer than {longest} bytes")
        return content


def read_json(path: Path) -> Any:
    """The values in a file of JSON; raises as `reading`."""
    content = read_bytes(path)
    with reading(path):
        return json.loads(content)


def read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """All arrays of an .npz, none of Python objects, checksums compared; raises as `reading`."""
    with reading(path) as stream, archive(stream) as opened:
        return {
            info.filename.removesuffix(".npy"): _array(opened, info) for info in opened.infolist()
        }


@contextmanager
def archive(stream: IO[bytes]) -> Iterator[zipfile.ZipFile]:
    """A zip archive that does not unpack to more than its length justifies.

    Raises:
        ValueError: if it would.
        zipfile.BadZipFile: if it is none.
    """
    length = stream.seek(0, io.SEEK_END)
    stream.seek(0)
    with zipfile.ZipFile(stream) as opened:
        unpacked = sum(info.file_size for info in opened.infolist())
        if unpacked > max(_FREE, _RATIO * length):
            raise ValueError(f"{length} bytes would unpack to {unpacked}")
        yield opened


def check_archive(stream: IO[bytes]) -> None:
    """Compare the checksums of a zip archive, and of those inside it; see `archive`.

    Raises:
        ValueError: if it would unpack to more than its length justifies.
        zipfile.BadZipFile: if it is none, or damaged.
    """
    with archive(stream) as opened:
        for info in opened.infolist():
            with opened.open(info) as member:
                if member.read(4) == b"PK\x03\x04":
                    member.seek(0)
                    check_archive(member)
                    member.seek(0)
                while member.read(1 << 20):
                    pass  # the checksum is compared at the end
    stream.seek(0)


def _array(opened: zipfile.ZipFile, info: zipfile.ZipInfo) -> NDArray[Any]:
    with opened.open(info) as member:
        version = np.lib.format.read_magic(member)
        headers = {
            (1, 0): np.lib.format.read_array_header_1_0,
            (2, 0): np.lib.format.read_array_header_2_0,
        }
        shape, _, dtype = headers[version](member)
        # numpy makes room for what the header claims before it reads what there is
        if dtype.hasobject or member.tell() + dtype.itemsize * _count(shape) != info.file_size:
            raise ValueError(f"{info.filename} is no array of this length")
    with opened.open(info) as member:
        array: NDArray[Any] = np.lib.format.read_array(member, allow_pickle=False)
        if member.read(1):  # the checksum is compared at the end
            raise ValueError(f"{info.filename} is longer than its array")
    return array


def _count(shape: tuple[int, ...]) -> int:
    count = 1
    for length in shape:
        if length < 0:
            raise ValueError("a length is negative")
        count *= length
    return count


def _reason(error: Exception) -> str:
    text = " ".join(str(getattr(error, "strerror", None) or error).split())
    return text[:200] or type(error).__name__
