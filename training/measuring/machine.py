"""What the benchmark ran on, in words."""

import os
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from .timing import usable_cores

_PACKAGES = ("numpy", "scipy", "numba", "torch", "clarabel")


def machine() -> dict[str, str]:
    """Processor, cores, system, Python, packages, GPU."""
    facts = {
        "processor": processor(),
        "cores": f"{len(usable_cores())} of {os.cpu_count()}",
        "system": f"{platform.system()} {platform.machine()}",
        "Python": platform.python_version(),
    }
    for package in _PACKAGES:
        try:
            facts[package] = version(package)
        except PackageNotFoundError:
            facts[package] = "not installed"
    if cuda_is_there():
        import torch

        facts["GPU"] = torch.cuda.get_device_name()
    else:
        facts["GPU"] = "none"
    return facts


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
