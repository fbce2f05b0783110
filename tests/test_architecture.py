"""The house stands as it is drawn: one direction of imports, nothing heavy at the door, no Qt below the widgets."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

from napari_elsplus.cli import COMMANDS

pytestmark = pytest.mark.checkout

PROJECT = Path(__file__).resolve().parents[1]
PACKAGE = PROJECT / "src" / "napari_elsplus"

ROOMS = (
    "errors",
    "compiled",
    "folders",
    "optics",
    "calibration",
    "processing",
    "simulation",
    "hardware",
    "io",
    "pipeline",
    "tracking_methods",
    "timing",
    "tracking_pipeline",
    "mosaic_plan",
    "pipelined",
    "acquisition",
    "evaluation",
    "figures",
    "demo",
    "diagnosis",
    "cli",
    "settings",
    "viewing",
    "napari's doors",
    "widgets",
)
"""From the first to the last: a room imports only from rooms before it, and from itself."""

NAPARI_DOORS = {"_reader", "_writer", "_sample_data", "_screen", "_window"}
PROCESSING = ("", "calibration", "tracking", "mosaicing")
"""The folders of ``processing``, likewise; calibration and tracking do not know each other."""
GUI_PACKAGES = {"napari", "qtpy", "magicgui", "PyQt5", "PyQt6", "PySide2", "PySide6", "superqt", "pyqtgraph", "vispy"}
HEAVY = ("napari", "qtpy", "PyQt6", "PySide6", "cv2", "numba")

MODULES = sorted(PACKAGE.rglob("*.py"))


def room_of(module: str) -> str:
    """The room of a dotted module name: the first part below the package."""
    first = module.split(".")[1]
    return "napari's doors" if first in NAPARI_DOORS else first


def dotted(path: Path) -> str:
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(path: Path) -> set[str]:
    """Every module that the file imports, wherever in it, type-checking blocks included."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.add(node.module)
            if node.module == "napari_elsplus":
                found.update(f"napari_elsplus.{alias.name}" for alias in node.names)
    return found


def is_command(path: Path) -> bool:
    """Whether the module defines ``command`` at its top level."""
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef) and node.name == "command":
            return True
        if isinstance(node, ast.Assign) and any(isinstance(t, ast.Name) and t.id == "command" for t in node.targets):
            return True
    return False


@pytest.mark.parametrize("path", MODULES, ids=dotted)
def test_imports_come_from_rooms_above(path: Path) -> None:
    if path == PACKAGE / "__init__.py":
        assert not {name for name in imports(path) if name.startswith("napari_elsplus")}
        return
    room = room_of(dotted(path))
    assert room in ROOMS, f"{room} is in no plan: name its place in ROOMS and in docs/architecture.md"
    allowed = ROOMS[: ROOMS.index(room) + 1]
    ours = {name for name in imports(path) if name.startswith("napari_elsplus.")} - {"napari_elsplus.__version__"}
    wrong = {name for name in ours if room_of(name) not in allowed}
    assert not wrong, f"{dotted(path)} is in {room} and imports from below: {sorted(wrong)}"


def folder_of(module: str) -> str:
    """The folder of ``processing`` that a dotted module name lies in."""
    parts = module.split(".")[2:]
    return parts[0] if parts and parts[0] in PROCESSING else ""


@pytest.mark.parametrize("path", [path for path in MODULES if PACKAGE / "processing" in path.parents], ids=dotted)
def test_processing_goes_from_images_to_calibration_or_to_tracks_and_from_tracks_to_mosaics(path: Path) -> None:
    folder = folder_of(dotted(path))
    allowed = set(PROCESSING[: PROCESSING.index(folder) + 1]) - ({"calibration"} if folder != "calibration" else set())
    ours = {name for name in imports(path) if name.startswith("napari_elsplus.processing.")}
    assert not {name for name in ours if folder_of(name) not in allowed}


@pytest.mark.parametrize("path", MODULES, ids=dotted)
def test_no_qt_and_no_napari_below_the_widgets(path: Path) -> None:
    if room_of(dotted(path) + ".") in ("napari's doors", "widgets"):
        return
    assert not {name for name in imports(path) if name.split(".")[0] in GUI_PACKAGES}


def test_nothing_imports_the_widgets() -> None:
    outside = [path for path in MODULES if PACKAGE / "widgets" not in path.parents]
    assert not [dotted(path) for path in outside if any(n.startswith("napari_elsplus.widgets") for n in imports(path))]


def test_importing_the_package_loads_nothing_heavy() -> None:
    code = f"import napari_elsplus, sys; print([m for m in {HEAVY!r} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_manifest_at_the_top_is_the_one_in_the_package() -> None:
    """A checkout without symlinks holds the link's target as text instead."""
    top, real = (PROJECT / "napari.yaml"), (PACKAGE / "napari.yaml")
    linked = top.is_symlink() and top.resolve() == real.resolve()
    assert linked or top.read_text(encoding="utf-8").strip() == "src/napari_elsplus/napari.yaml"


def test_every_command_has_its_module_and_every_such_module_is_listed() -> None:
    modules = {path.stem for path in (PACKAGE / "cli").glob("*.py") if path.stem != "__init__" and is_command(path)}
    assert modules == set(COMMANDS)
    assert len(COMMANDS) == len(set(COMMANDS))
