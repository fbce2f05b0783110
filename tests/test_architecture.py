"""The architecture holds: one direction of imports, small folders, nothing heavy at import, no Qt below the widgets."""

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

ORDER = (
    "errors",
    "closing",
    "_program",
    "instrument",
    "processing.compilation",
    "processing.compiled",
    "processing.progress",
    "processing.vectors",
    "processing.images",
    "processing.analysis",
    "processing.calibration.line",
    "processing.calibration.bundle",
    "processing.calibration",
    "processing.axial",
    "processing.tracking.motion",
    "processing.tracking.front_end",
    "processing.tracking.registration",
    "processing.tracking.tracker",
    "processing.tracking.pose_graph",
    "processing.tracking",
    "processing.mosaicing",
    "io.atomic",
    "io.disk",
    "io.stored_frames",
    "io.user_folders",
    "io.settings",
    "io.calibrations",
    "io.formats",
    "io",
    "simulation.model",
    "simulation.specimen",
    "simulation.rendering",
    "simulation",
    "hardware.scan",
    "hardware.parking",
    "hardware.protocols",
    "hardware.limits",
    "hardware.priority",
    "hardware.micro_manager",
    "hardware.u3v",
    "hardware.daq",
    "hardware.detached",
    "hardware.outside",
    "hardware.takeover",
    "hardware.guardian",
    "hardware.virtual.timeline",
    "hardware.virtual.galvo",
    "hardware.virtual.remembered_frames",
    "hardware.virtual.scene_frames",
    "hardware.virtual.card",
    "hardware.virtual.camera",
    "hardware.virtual.bench",
    "hardware.rig",
    "hardware.virtual",
    "hardware",
    "workflows.pictures",
    "workflows",
    "acquisition.streaming",
    "acquisition.mosaic",
    "acquisition.engine",
    "acquisition.calibrating",
    "acquisition.live_engine",
    "acquisition.link",
    "_screen",
    "diagnosis",
    "viewing",
    "viewing.mosaic",
    "_view",
    "_problems",
    "widgets.shared",
    "widgets.calibration",
    "widgets.live",
    "widgets.mosaic",
    "widgets.analysis",
    "widgets.dock",
    "_reader",
    "_writer",
    "_sample_data",
    "_window",
    "cli",
    "__main__",
)
"""From the lowest to the highest: a module imports only from its own room and from rooms before it."""

GUI_PACKAGES = {"napari", "qtpy", "magicgui", "PyQt5", "PyQt6", "PySide2", "PySide6", "superqt", "pyqtgraph", "vispy"}
GUI_ROOMS = ("widgets", "_view", "_problems", "_reader", "_writer", "_sample_data", "_screen", "_window")
HEAVY = ("napari", "qtpy", "PyQt6", "PySide6", "cv2", "numba", "numpy")
MOST_MODULES_IN_A_FOLDER = 12

MODULES = {
    ".".join(path.relative_to(PACKAGE).with_suffix("").parts).removesuffix(".__init__"): path
    for path in sorted(PACKAGE.rglob("*.py"))
    if path != PACKAGE / "__init__.py"
}


def room_of(module: str) -> int:
    """Index in ORDER of the longest name that the module's begins with."""
    rooms = [room for room in ORDER if f"{module}.".startswith(f"{room}.")]
    assert rooms, f"{module} has no place in ORDER: give it one here and in docs/architecture.md"
    return ORDER.index(max(rooms, key=len))


def imports(path: Path) -> set[str]:
    """Modules that the file imports anywhere in it, or names in a string."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            submodules = {f"{node.module}.{alias.name}" for alias in node.names}
            known = {name for name in submodules if name.removeprefix("napari_elsplus.") in MODULES}
            found.update(known or {node.module})
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and " " not in node.value:
            named = node.value.partition(":")[0].removeprefix("napari_elsplus.")
            if node.value.startswith("napari_elsplus.") and named in MODULES:
                found.add(f"napari_elsplus.{named}")
    return found


def ours(module: str) -> set[str]:
    """Modules of the package, without the package's name, that a module imports."""
    found = {name.removeprefix("napari_elsplus.") for name in imports(MODULES[module]) if "napari_elsplus." in name}
    return found & set(MODULES)


@pytest.mark.parametrize("module", MODULES)
def test_imports_go_one_way(module: str) -> None:
    upward = {name for name in ours(module) if room_of(name) > room_of(module)}
    assert not upward, f"{module} ({ORDER[room_of(module)]}) imports from above: {sorted(upward)}"


def test_no_module_imports_itself_by_way_of_others() -> None:
    open_ends = {module: ours(module) - {module} for module in MODULES}
    while leaves := {module for module, needs in open_ends.items() if not needs & set(open_ends)}:
        open_ends = {module: needs for module, needs in open_ends.items() if module not in leaves}
    assert not open_ends, "modules in circles, or standing on one"


@pytest.mark.parametrize("module", [name for name in MODULES if name.split(".")[0] not in GUI_ROOMS])
def test_no_qt_and_no_napari_below_the_widgets(module: str) -> None:
    assert not {name for name in imports(MODULES[module]) if name.split(".")[0] in GUI_PACKAGES}


def test_the_widgets_are_imported_only_by_the_manifest_and_each_other() -> None:
    outside = [module for module in MODULES if not module.startswith("widgets")]
    assert not [module for module in outside if any(name.startswith("widgets") for name in ours(module))]


def test_no_folder_is_crowded() -> None:
    folders = {path.parent for path in MODULES.values()}
    sizes = {str(folder.relative_to(PACKAGE)): len([*folder.glob("[!_]*.py")]) for folder in folders}
    assert not {folder: size for folder, size in sizes.items() if size > MOST_MODULES_IN_A_FOLDER}


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
    for folder in ("files", "rig"):
        defining = {p.stem for p in (PACKAGE / "cli" / folder).glob("*.py") if "\ndef command(" in p.read_text("utf-8")}
        defining |= {p.stem for p in (PACKAGE / "cli" / folder).glob("*.py") if "\ncommand = " in p.read_text("utf-8")}
        assert defining - {"window"} == {name for name, listed in COMMANDS.items() if listed.folder == folder}
