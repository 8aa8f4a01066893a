"""Pages of docs/: a template of a study with Jinja's gaps, and pictures beside the page."""

from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

from jinja2 import Environment, StrictUndefined
from matplotlib.figure import Figure

from solvers.files import make_folder, write_text

from . import numbers
from .figures import save

_ENVIRONMENT = Environment(
    undefined=StrictUndefined,
    keep_trailing_newline=True,
    trim_blocks=True,
    lstrip_blocks=True,
    autoescape=False,
)
_ENVIRONMENT.filters |= {
    form.__name__: form
    for form in (
        numbers.factor,
        numbers.listed,
        numbers.percentage,
        numbers.rate,
        numbers.ratio,
        numbers.share,
    )
}


def write_page(
    path: Path, package: str, fields: Mapping[str, Any], figures: Mapping[str, Figure]
) -> None:
    """Write a page from `template.md` of a package, and its pictures beside it.

    In the template `picture("name")` is the file of a picture, `picture()` that of the only one;
    the forms of `training.reports.numbers` are filters.

    Args:
        path: of the Markdown file; pictures are called after it.
        package: of the study, `__package__`.
        fields: what fills the template; one that is missing is an error.
        figures: pictures by name, "" for the only one.
    """

    def picture(name: str = "") -> str:
        return f"{path.stem}{'_' * bool(name)}{name}.png"

    make_folder(path.parent)
    template = files(package).joinpath("template.md").read_text(encoding="utf-8")
    text = _ENVIRONMENT.from_string(template).render(fields, picture=picture)
    write_text(path, text)
    for name, figure in figures.items():
        save(figure, path.with_name(picture(name)))
