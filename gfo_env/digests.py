"""Digests of sources, for caches of what was made by them."""

import hashlib
from pathlib import Path


def digest(*rooms: str) -> str:
    """Changes with any source file of these rooms of the package: folders, or single modules.

    numba renews its cached code when the file of the compiled function changes, but not when a
    function of another file that was inlined into it does. A function that closes over this string
    is compiled anew in either case, because numba's cache distinguishes functions by what they
    close over.
    """
    here = Path(__file__).parent
    content = hashlib.sha256()
    for room in rooms:
        files = sorted([*here.glob(f"{room}.py"), *(here / room).rglob("*.py")])
        if not files:
            raise FileNotFoundError(f"{here.name} has no room {room!r}")
        for path in files:
            content.update(path.relative_to(here).as_posix().encode() + b"\0")
            content.update(path.read_bytes() + b"\0")
    return content.hexdigest()
