"""Checks of the installed packages."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, entry_points, requires, version
from typing import TYPE_CHECKING

from packaging.requirements import Requirement

from napari_elsplus import __version__
from napari_elsplus.diagnosis.finding import Finding, ok, problem, warning

if TYPE_CHECKING:
    from collections.abc import Iterator


NAMED_FIRST = ("napari", "numpy", "scikit-image", "opencv-contrib-python-headless", "numba", "pyusb", "nidaqmx")
"""Packages whose versions are reported."""
OPENCV = "opencv-contrib-python-headless"
OTHER_OPENCV = ("opencv-python", "opencv-python-headless", "opencv-contrib-python")
"""Distributions that write into the same folder as `OPENCV`."""
QT_BINDINGS = {"PyQt6": ("PyQt6",), "PySide6": ("PySide6", "PySide6-Essentials")}
"""Each Qt binding that we test with, and the distributions that bring it."""


def python() -> Iterator[Finding]:
    """Report the versions of Python and of this package."""
    yield ok(f"Python {platform.python_version()} on {platform.platform()}, napari-elsplus {__version__}")


def packages() -> Iterator[Finding]:
    """Compare the installed packages with the requirements."""
    try:
        stated = [Requirement(line) for line in requires("napari-elsplus") or ()]
    except PackageNotFoundError:
        yield problem("napari-elsplus runs, but is not installed", 'pip install "napari-elsplus[pyqt]"')
        return
    needed = [need for need in stated if need.marker is None or need.marker.evaluate({"extra": ""})]
    unmet = {need: have for need in needed if not _satisfies(have := installed_version(need.name), need)}
    for need, have in unmet.items():
        yield problem(f"{need.name} is {have or 'absent'}, {need.specifier} needed", f'pip install "{need}"')
    if not unmet:
        some = ", ".join(f"{name} {installed_version(name)}" for name in NAMED_FIRST)
        yield ok(f"all {len(needed)} packages that are needed are there: {some} and others")


def one_opencv() -> Iterator[Finding]:
    """Check that no other OpenCV wheel has written into the same folder."""
    others = [name for name in OTHER_OPENCV if installed_version(name)]
    remedy = f"pip uninstall --yes {' '.join([*others, OPENCV])}, then pip install {OPENCV}"
    try:
        from cv2 import __version__ as opencv_version
        from cv2 import reg
    except ImportError as error:
        yield problem(f"OpenCV cannot be used ({_first_line(error)})", remedy)
        return
    if others:
        yield warning(f"{', '.join(others)} lies in the same folder as {OPENCV}: either may break the other", remedy)
    else:
        yield ok(f"OpenCV {opencv_version} with its motion models ({reg.__name__})")


def qt_binding() -> Iterator[Finding]:
    """Check that a Qt binding is installed."""
    present = {
        binding: found
        for binding, names in QT_BINDINGS.items()
        if (found := next(filter(None, map(installed_version, names)), None))
    }
    if present:
        yield ok("Qt from " + " and ".join(f"{binding} {found}" for binding, found in present.items()))
    else:
        yield warning("no Qt binding is installed, so no window can be opened", 'pip install "napari-elsplus[pyqt]"')


def plugin() -> Iterator[Finding]:
    """Check that napari finds the plugin."""
    if any(entry.value == "napari_elsplus:napari.yaml" for entry in entry_points(group="napari.manifest")):
        yield ok("napari finds the plugin")
    else:
        yield problem("napari does not find the plugin", "pip install --force-reinstall --no-deps napari-elsplus")


def kernel_cache() -> Iterator[Finding]:
    """Check that compiled kernels are kept between runs."""
    from napari_elsplus.processing.compiled import kernel

    folder = kernel(_plus_one).stats.cache_path  # type: ignore[attr-defined]
    if folder:
        yield ok(f"compiled kernels are kept in {folder}")
    else:
        yield warning(
            "compiled kernels cannot be kept, so every start compiles them anew",
            "set NUMBA_CACHE_DIR to a folder that you can write to",
        )


def installed_version(distribution: str) -> str | None:
    """Return the version of an installed distribution, or None."""
    try:
        return version(distribution)
    except PackageNotFoundError:
        return None


def _satisfies(have: str | None, need: Requirement) -> bool:
    return have is not None and need.specifier.contains(have, prereleases=True)


def _first_line(error: Exception) -> str:
    return str(error).strip().partition("\n")[0]


def _plus_one(number: int) -> int:
    return number + 1


CHECKS = (python, packages, one_opencv, qt_binding, plugin, kernel_cache)
"""Checks of this module, in order."""
