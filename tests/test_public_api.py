"""The public interface: its names, where they come from, and what importing the package loads."""

from __future__ import annotations

import ast
import inspect
import subprocess
import sys
from pathlib import Path

import pytest

import napari_elsplus


@pytest.mark.parametrize("name", napari_elsplus.__all__)
def test_every_public_name_is_documented_and_imported_when_used(name: str) -> None:
    assert name in dir(napari_elsplus)
    assert inspect.getdoc(getattr(napari_elsplus, name))


def test_type_checkers_see_the_names_that_are_imported_when_used() -> None:
    tree = ast.parse(Path(napari_elsplus.__file__).read_text(encoding="utf-8"))
    (block,) = [node for node in tree.body if isinstance(node, ast.If)]
    stated = {}
    for node in block.body:
        assert isinstance(node, ast.ImportFrom)
        for alias in node.names:
            module = str(node.module).removeprefix("napari_elsplus.")
            stated[alias.asname] = f"{module}:{alias.name}"
    assert stated == napari_elsplus._PLACES
    assert set(napari_elsplus.__all__) == set(stated)


def test_a_name_that_does_not_exist_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'sectionn'"):
        _ = napari_elsplus.sectionn


def test_a_name_loads_only_what_it_needs() -> None:
    code = (
        "import sys, napari_elsplus; napari_elsplus.Calibration;"
        "print([m for m in ('cv2', 'numba', 'matplotlib', 'napari') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
