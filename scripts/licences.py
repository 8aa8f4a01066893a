"""Write docs/licences.md: under what licences stand the packages that GraspForce needs at run time.

    python scripts/licences.py

The words are those of the installed packages' own metadata.
"""

from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

PAGE = Path(__file__).parents[1] / "docs" / "licences.md"

_HEAD = (
    "# Licences\n\n"
    "GraspForce is under the MIT licence. `python scripts/licences.py` made this table from the "
    "metadata of the\ninstalled packages: those that `pip install graspforce` brings, with all "
    "that these need in turn. Licences of the\nextras are not in it, nor are those of the CUDA "
    "libraries that PyTorch's default build brings (proprietary, by\nNVIDIA). Where several "
    "licences are named, parts of the package stand under each.\n\n"
    "| package | version | licence |\n| --- | --- | --- |\n"
)

_CLASSIFIER = "License :: OSI Approved :: "


def needed(root: str = "graspforce") -> dict[str, Distribution]:
    """The installed packages that the root needs, itself left out, by their canonical names."""
    found: dict[str, Distribution] = {}
    waiting = [root]
    while waiting:
        for text in distribution(waiting.pop()).requires or ():
            requirement = Requirement(text)
            if requirement.marker and not requirement.marker.evaluate({"extra": ""}):
                continue
            name = canonicalize_name(requirement.name)
            if name in found or name.startswith(("nvidia-", "cuda-")) or name == "triton":
                continue
            try:
                found[name] = distribution(name)
            except PackageNotFoundError:
                continue  # for another platform
            waiting.append(name)
    return dict(sorted(found.items()))


def licence(package: Distribution) -> str:
    """The package's licence in its own words, in one line."""
    metadata = package.metadata
    text = str(metadata["License-Expression"] or "")
    if not text:
        classifiers = metadata.get_all("Classifier") or []
        text = ", ".join(
            line.removeprefix(_CLASSIFIER) for line in classifiers if line.startswith(_CLASSIFIER)
        )
    if not text:
        # some write the whole text of the licence here
        text = str(metadata["License"] or "not said").strip().splitlines()[0]
    return text


def page() -> str:
    """The whole page."""
    rows = [f"| {name} | {one.version} | {licence(one)} |" for name, one in needed().items()]
    return _HEAD + "\n".join(rows) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    print(f"wrote {PAGE}")
