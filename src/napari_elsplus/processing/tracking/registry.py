"""Tracking methods by name: read by the command line, the Mosaic panel, the engine and the benchmarks.

A package adds a method by calling :func:`register_tracking_method` in a function that its entry point names, so that
every process finds it, the engine's too::

    [project.entry-points."napari_elsplus.tracking_methods"]
    phase-correlation = "my_package.tracking:register"
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from functools import cache, partial
from importlib.metadata import entry_points
from typing import TYPE_CHECKING, Any, Final
from warnings import warn

from napari_elsplus.errors import InputError
from napari_elsplus.processing.tracking.methods import RegistrationTracking, TrackingMethod
from napari_elsplus.processing.tracking.pairwise_tracking import PairwiseRegistrar, PairwiseRegistration
from napari_elsplus.processing.tracking.template_tracking import SIDE_PX, TEMPLATE_PX, TemplateTracking
from napari_elsplus.processing.tracking.tracker import MAX_DISPLACEMENT_DIAMETERS

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.images.sectioning import Mode

ENTRY_POINTS: Final = "napari_elsplus.tracking_methods"
"""Group of the entry points that register methods of other packages."""


class Method(StrEnum):
    """Names of the built-in tracking methods."""

    ELSPLUS = "elsplus"
    """Sub-pixel registration with rolling-shutter correction, acceptance tests and loop closure."""
    PAPER = "paper"
    """Whole-pixel template matching from frame to frame (Thrapp and Hughes 2021): the baseline."""


@dataclass(frozen=True, slots=True)
class RegisteredMethod:
    """A tracking method and its properties.

    Parameters
    ----------
    name : str
        As on the command line and in files.
    factory : callable
        ``factory(calibration, frame_shape, mode)`` makes it, once for each recording and each live mosaic; what a
        :class:`TrackingMethod` needs of the calibration may be absent, and a `CalibrationError` is shown to the user.
    description : str
        One line, for help texts and tooltips.
    max_displacement : callable
        Largest displacement between successive frames that is tracked, pixels of its grid, from the diameter of the
        bundle in these pixels; by default 0.6 diameters.
    corrects_rolling_shutter : bool
        True if it uses the line periods per frame, which are then estimated where the calibration lacks them.
    closes_loops : bool
        True if its :attr:`~.TrackingMethod.newest_registration` can carry live loop closure.
    tapers_rim : bool
        True if frames are inserted with weights that fall off towards the rim; the paper's are not.
    """

    name: str
    factory: Callable[[Calibration, tuple[int, int], Mode], TrackingMethod]
    description: str
    max_displacement: Callable[[float], float] = lambda diameter: MAX_DISPLACEMENT_DIAMETERS * diameter
    corrects_rolling_shutter: bool = True
    closes_loops: bool = False
    tapers_rim: bool = True


_BUILT_IN: Final = (
    RegisteredMethod(
        Method.ELSPLUS.value, RegistrationTracking, "sub-pixel, rolling shutter corrected, loops closed",
        closes_loops=True,
    ),
    RegisteredMethod(
        Method.PAPER.value, TemplateTracking, "the paper's template matching", lambda _: (SIDE_PX - TEMPLATE_PX) / 2,
        corrects_rolling_shutter=False, tapers_rim=False,
    ),
)  # fmt: skip
_METHODS: Final = {method.name: method for method in _BUILT_IN}


def register_tracking_method(
    name: str,
    factory: Callable[[Calibration, tuple[int, int], Mode], TrackingMethod],
    description: str,
    **properties: Any,
) -> None:
    """Add a tracking method, or replace one that was added; parameters are those of :class:`RegisteredMethod`.

    Raises
    ------
    InputError
        If the name is that of a built-in method, or no word.
    """
    if name in list(Method) or not name or not name.replace("-", "").replace("_", "").isalnum():
        raise InputError(f"a tracking method cannot be called {name!r}", "choose a word that is not taken")
    _METHODS[name] = RegisteredMethod(name, factory, description, **properties)


def register_pairwise_method(name: str, register: PairwiseRegistration, description: str) -> None:
    """Add a tracking method made of a pairwise registration function.

    Parameters
    ----------
    name : str
        As on the command line and in files.
    register : PairwiseRegistration
        ``register(fixed, moving, expected)`` returns a :class:`~.pairwise_tracking.PairwiseShift`, or None where the
        images do not determine the shift.
    description : str
        One line, for help texts and tooltips.
    """
    registrar = partial(PairwiseRegistrar, register=register)
    register_tracking_method(name, partial(RegistrationTracking, registrar=registrar), description)


def tracking_methods() -> Mapping[str, RegisteredMethod]:
    """Return all tracking methods by name, the built-in ones first; those of installed packages are loaded once."""
    _load_entry_points()
    return dict(_METHODS)


def tracking_method(name: str) -> RegisteredMethod:
    """Return the tracking method of this name.

    Raises
    ------
    InputError
        If there is none.
    """
    if name not in _METHODS:
        _load_entry_points()
    if name not in _METHODS:
        raise InputError(f"there is no tracking method {name!r}", f"choose one of {', '.join(_METHODS)}")
    return _METHODS[name]


@cache
def _load_entry_points() -> None:
    """Run the functions by which installed packages register their methods; warn of those that cannot be loaded."""
    for entry in entry_points(group=ENTRY_POINTS):
        try:
            register = entry.load()
        except (ImportError, AttributeError) as error:
            warn(f"the tracking method {entry.name} ({entry.value}) cannot be loaded: {error}", stacklevel=2)
            continue
        register()
