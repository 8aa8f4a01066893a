"""Digests of sources, for caches of what was made by them."""

import hashlib
from pathlib import Path


def digest(*modules: str) -> str:
    """Changes with the source of any of these modules of the package.

    numba renews its cached code when the file of the compiled function changes, but not when a
    function of another file that was inlined into it does. A function that closes over this string
    is compiled anew in either case, because numba's cache distinguishes functions by what they
    close over.
    """
    here = Path(__file__)
    content = [here.with_name(f"{module}{here.suffix}").read_bytes() for module in modules]
    return hashlib.sha256(b"\0".join(content)).hexdigest()
