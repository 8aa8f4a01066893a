"""Files that outlive a run: where the user's cache is, and writing whole or not at all."""

import os
import secrets
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any


def cache_folder(kind: str) -> Path:
    """`graspforce/<kind>` below $XDG_CACHE_HOME or ~/.cache; it need not exist yet.

    A user without a home, as containers may have, gets a folder in the place for temporary files.
    """
    root = os.environ.get("XDG_CACHE_HOME")
    if root:
        return Path(root) / "graspforce" / kind
    try:
        home = Path.home()
    except RuntimeError:
        return Path(tempfile.gettempdir()) / "graspforce" / kind
    return home / ".cache" / "graspforce" / kind


def write_atomically(path: Path, write: Callable[[IO[bytes]], Any]) -> None:
    """Write a file whole or not at all, while others may read or write the same one.

    Args:
        path: of the file; its folder is made if there is none.
        write: puts the content into a stream.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f"{path.name}.{os.getpid()}-{secrets.token_hex(4)}.partial")
    try:
        with partial.open("xb") as stream:
            write(stream)
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)
