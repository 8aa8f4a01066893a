"""The kinds of cases, each loaded where it is tried, because some need a simulator or torch."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module

from tests.fuzz.outcome import Case


@dataclass(frozen=True)
class Kind:
    """Where the cases of a kind are made.

    Args:
        module: in this package; `prepare` there loads and compiles what is not to be timed.
        name: of the function that tries one.
        share: of all cases, relative to the other kinds; 0: only by name.
    """

    module: str
    name: str
    share: float

    def load(self) -> tuple[Callable[[], None], Case]:
        module = import_module(f"tests.fuzz.{self.module}")
        return module.prepare, getattr(module, self.name)


KINDS = {
    "problems": Kind("problems", "try_exact", 40),
    "solvers": Kind("problems", "try_any", 10),
    "quality": Kind("problems", "try_quality", 2),
    "batches": Kind("problems", "try_batch", 4),
    "arguments": Kind("arguments", "try_arguments", 20),
    "meshes": Kind("meshes", "try_mesh", 8),
    "files": Kind("files", "try_file", 12),
    "environments": Kind("settings", "try_environment", 2),
    "hands": Kind("hands", "try_hand", 3),
    "trainings": Kind("settings", "try_training", 2),
    "misbehaving": Kind("misbehaving", "try_nothing_good", 0),
}
