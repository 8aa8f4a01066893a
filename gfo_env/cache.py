"""Where the user's cache is."""

import os
import tempfile
from pathlib import Path


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
