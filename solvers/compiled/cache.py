"""A digest of this package's sources, for the cache of compiled code."""

import hashlib
from pathlib import Path


def digest() -> str:
    """Changes with any source file of the package.

    numba renews its cached code when the file of the compiled function changes, but not when a
    function that was inlined into it does. An entry point that closes over this string is compiled
    anew in either case, because numba's cache distinguishes functions by what they close over.
    """
    text = b"".join(path.read_bytes() for path in sorted(Path(__file__).parent.rglob("*.py")))
    return hashlib.sha256(text).hexdigest()
