"""What every command shares: arguments from a dataclass, one clear line on bad input."""

import dataclasses
import os
import signal
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

# Problems are small, and processes fill the cores: threads inside them get in each other's way.
# Set before anything loads numpy or torch.
os.environ.setdefault("OMP_NUM_THREADS", "1")

import tyro

from solvers.exceptions import GraspForceError

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress

    from gfo_env.objects import ObjectSet
    from training.reports.results import Run


class _Settings(Protocol):
    @property
    def json(self) -> Path | None: ...


Settings = TypeVar("Settings", bound=_Settings)


def run_cli(settings: type[Settings], main: Callable[[Settings], None]) -> None:
    """Parse the command line into `settings` and run `main`; exit with 2 on bad input.

    A path that cannot be read or written is bad input, too, and so is what needs more memory than
    there is.
    """
    # a polite kill ends like an interruption: workers stop, and what is finished is kept
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        arguments = tyro.cli(settings)
        expect_file(arguments.json)
        main(arguments)
    except (GraspForceError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    except MemoryError as error:
        print(f"error: out of memory ({error}); ask for less at once", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        sys.exit(130)


def expect_file(path: Path | None) -> None:
    """Find out before the work, not after it, that a result cannot be written there."""
    from solvers.files import make_folder

    if path is not None:
        make_folder(path.parent)
        if path.is_dir():
            raise IsADirectoryError(f"{path} is a folder; name a file to write the result to")


def write_json(path: Path | None, result: Any) -> None:
    """Write a result where the user asked for it, if they did."""
    from solvers import files

    if path is not None:
        files.write_json(path, result)


def bars(console: "Console | None" = None) -> "Progress":
    """Progress bars that count, with the time since they began and the time that is left."""
    from rich.progress import MofNCompleteColumn, Progress, TimeElapsedColumn, TimeRemainingColumn

    times = (TimeElapsedColumn(), TimeRemainingColumn())
    columns = (*Progress.get_default_columns()[:2], MofNCompleteColumn(), *times)
    return Progress(*columns, console=console)


# -- commands that take objects --------------------------------------------------------------------


@dataclass(frozen=True)
class ObjectOptions:
    """Options of every command that takes a set of objects."""

    objects: str = "random_urdfs"
    """`random_urdfs`, or a folder of meshes."""
    pattern: str | None = None
    """Which files of a folder are objects: "**/nontextured.ply", say. Default: all."""
    scale: float | None = None
    """Metres per unit of a folder's files: 0.001 for millimetres. Default: files in metres."""
    target_size: float | None = None
    """Scale every mesh of a folder so that its longest edge has this length, in metres."""

    def open(self, split: str) -> "ObjectSet":
        """The objects that were asked for; files that are no solids are named and left out."""
        import warnings

        from gfo_env.exceptions import MeshWarning
        from gfo_env.objects import ObjectSet

        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", MeshWarning)
            objects = ObjectSet(
                self.objects,
                split,
                target_size=self.target_size,
                scale=self.scale,
                pattern=self.pattern,
            )
        for warning in caught:
            print(f"warning: {warning.message}", file=sys.stderr)
        return objects


# -- commands that write a page --------------------------------------------------------------------

Results = TypeVar("Results")


@dataclass(frozen=True)
class ResultFiles:
    """Options of every command that writes a page."""

    from_json: Path | None = None
    """Write the page anew from what --json wrote; nothing is measured."""
    json: Path | None = None
    """Write all results here: for --from-json, and for other uses."""


class _PageSettings(Protocol):
    @property
    def page(self) -> Path: ...
    @property
    def from_json(self) -> Path | None: ...
    @property
    def json(self) -> Path | None: ...


def write_study(
    settings: _PageSettings,
    kind: "type[Results]",
    measure: "Callable[[Progress], Results]",
    write_page: "Callable[[Run[Results], Path], str]",
    command: str,
    facts: "Callable[[], dict[str, str]] | None" = None,
) -> None:
    """Measure, or read results; write them and the page, and say what came out.

    Args:
        settings: of the command.
        kind: of the results.
        measure: what takes long.
        write_page: that returns a summary for the terminal.
        command: that makes the same again.
        facts: of the machine.
    """
    from rich.console import Console

    from training.measuring.machine import machine
    from training.reports.results import Run, load_run, save_run

    expect_file(settings.page)
    console = Console()
    if settings.from_json is not None:
        run = load_run(settings.from_json, kind)
    else:
        with bars(console) as progress:
            run = Run(command, (facts or machine)(), measure(progress))
    if settings.json is not None:
        save_run(run, settings.json)
    console.print(write_page(run, settings.page), markup=False, highlight=False)
    console.print(f"Page: {settings.page}")


def command_line(script: str, settings: Any, *names: str, always: tuple[str, ...] = ()) -> str:
    """The command that does the same again, for the reader of a page.

    Args:
        script: its name.
        settings: a dataclass.
        names: of options that decide the results, in their order; files by their names alone.
        always: those of them that are named even where they are the default.
    """
    words = [f"python scripts/{script}.py"]
    defaults = {field.name: field.default for field in dataclasses.fields(settings)}
    for name in names:
        value = getattr(settings, name)
        if name in always or value != defaults[name]:
            several = value if isinstance(value, tuple) else (value,)
            words += [f"--{name.replace('_', '-')}", *map(_word, several)]
    return " ".join(words)


def _word(value: Any) -> str:
    if isinstance(value, Path):
        return value.name
    return f"{value:g}" if isinstance(value, float) else str(value)
