"""What a study ran on, in words."""

import platform
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from .timing import usable_cores


def machine(packages: Sequence[str] = ()) -> dict[str, str]:
    """Processor, cores that may be used, system, Python, and versions of packages."""
    facts = {
        "processor": processor(),
        "cores": str(len(usable_cores())),
        "system": f"{platform.system()} {platform.machine()}",
        "Python": platform.python_version(),
    }
    for package in packages:
        try:
            facts[package] = version(package)
        except PackageNotFoundError:
            facts[package] = "not installed"
    return facts


def gpu() -> str:
    """The name of the GPU, or "none"."""
    if not cuda_is_there():
        return "none"
    import torch

    return torch.cuda.get_device_name()


def processor() -> str:
    """The processor's name as the system gives it."""
    information = Path("/proc/cpuinfo")
    if information.exists():
        for line in information.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def cuda_is_there() -> bool:
    """Whether torch and a GPU that it can use are here."""
    try:
        import torch
    except ImportError:
        return False
    return bool(torch.cuda.is_available())
