"""Modules that have moved are found by the names that they had."""

import sys
from importlib import import_module

import pytest

import gfo_env
from gfo_env.objects import Patches


@pytest.mark.parametrize(("old", "new"), gfo_env._MOVED.items())
def test_the_old_name_hands_on(old: str, new: str) -> None:
    sys.modules.pop(old, None)
    place = import_module(new)
    with pytest.warns(DeprecationWarning, match=f"{old} is now {new}"):
        moved = import_module(old)
    public = [name for name in dir(place) if not name.startswith("_")]
    assert public
    for name in public:
        assert getattr(moved, name) is getattr(place, name)


def test_a_name_is_imported_from_the_old_module() -> None:
    sys.modules.pop("gfo_env.patches", None)
    with pytest.warns(DeprecationWarning, match="gfo_env.patches is now gfo_env.objects"):
        from gfo_env.patches import Patches as same  # type: ignore[import-not-found]
    assert same is Patches


def test_what_never_was_is_not_found() -> None:
    with pytest.raises(ModuleNotFoundError):
        import_module("gfo_env.nothing")
