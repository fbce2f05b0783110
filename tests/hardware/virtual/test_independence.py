"""The virtual devices share no code with the drivers that they judge."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import napari_elsplus.hardware.virtual as virtual

FOLDERS = [Path(virtual.__file__).parent / name for name in ("camera", "card")]


@pytest.mark.parametrize("module", [path for folder in FOLDERS for path in sorted(folder.glob("*.py"))], ids=str)
def test_no_virtual_device_imports_from_a_driver(module: Path) -> None:
    names = set()
    for node in ast.walk(ast.parse(module.read_text("utf-8"))):
        if isinstance(node, ast.ImportFrom):
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
    drivers = ("napari_elsplus.hardware.u3v", "napari_elsplus.hardware.daq")
    assert not [name for name in names if name.startswith(drivers)]
