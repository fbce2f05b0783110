"""Axial responses measured from a stack, by manual steps, or by simulation; drop-offs against slit parameters."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from napari_elsplus.errors import InputError, MeasurementError
from napari_elsplus.instrument.arguments import Choice
from napari_elsplus.processing.analysis.slit_offset import SaturationFit, fit_saturation
from napari_elsplus.processing.axial.axial_notes import axial_content
from napari_elsplus.processing.axial.axial_response import AxialResponse, SystematicUncertainty, axial_response
from napari_elsplus.processing.axial.profiles import axial_profiles
from napari_elsplus.viewing.lazy import LazyPlanes
from napari_elsplus.viewing.script import recording_script
from napari_elsplus.viewing.stack import Stack
from napari_elsplus.workflows.axial import measure_axial_response
from napari_elsplus.workflows.simulated import simulate_axial_scan

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.processing.axial.black_level import DarkLevels
    from napari_elsplus.processing.axial.tilt import SquareHalves
    from napari_elsplus.processing.progress import ProgressWrapper

MANUAL_SCAN: Final = "manual"
"""Beginning of the name of a manual scan."""
MIN_SCANS_FOR_FIT: Final = 3
"""Distinct offsets, one more than the two parameters of the saturating curve."""


class SlitParameter(Choice):
    """Slit parameter against which drop-offs are plotted."""

    OFFSET = "slit offset"
    SLIT = "slit width"


@dataclass(frozen=True)
class Scan:
    """An axial response and the slit that it was measured with.

    Attributes
    ----------
    name : str
        Name of the recording, or how the scan was made.
    response : AxialResponse
        Curves and drop-offs.
    offset_um, slit_um : float or None
        Slit offset (as a distance) and slit width at the bundle, None where the calibration lacks them.
    """

    name: str
    response: AxialResponse
    offset_um: float | None
    slit_um: float | None

    def content(self) -> dict[str, Any]:
        """Return the scan as a dictionary for JSON."""
        return {
            "name": self.name,
            "offset_um": self.offset_um,
            "slit_um": self.slit_um,
            **axial_content(self.response),
        }


@dataclass
class ManualScan:
    """A scan acquired frame by frame while the stage is moved by hand."""

    depth_um: list[float] = field(default_factory=list)
    ls: list[float] = field(default_factory=list)
    residual: list[float] = field(default_factory=list)
    systematic: SystematicUncertainty | None = None
    """Uncertainty common to all depths, from the two darkest successive frames."""
    dark: DarkLevels | None = None
    """Level of the pixels beside the views in each frame."""
    halves: SquareHalves | None = None
    """Light of the measured square's halves in each frame."""
    _last: NDArray[Any] | None = None

    def take(self, frame: NDArray[Any], calibration: Calibration, depth_um: float) -> None:
        """Add a raw frame acquired at a depth.

        Parameters
        ----------
        frame : numpy.ndarray
            (rows, cols), raw.
        calibration : Calibration
            Of the rig that acquired it.
        depth_um : float
            Depth of the plate.

        Raises
        ------
        CalibrationError
            If the calibration does not fit the frame or lacks the scale.
        InputError
            If it is the frame that was added last.
        MeasurementError
            If the measured square does not fit into the bundle, or is saturated.
        """
        if self._last is not None and np.array_equal(frame, self._last):
            remedy = "display the next frame, or start the stream and choose its raw frame"
            raise InputError(f"this frame was added at {self.depth_um[-1]:g} µm", remedy)
        frames = [frame] if self._last is None else [frame, self._last]
        ls, residual, systematic, dark, halves = axial_profiles(
            frames, calibration, depths_um=[depth_um, *self.depth_um[-1:]]
        )
        if self.systematic is None or ls.sum() <= min(map(sum, pairwise(self.ls)), default=np.inf):
            self.systematic = systematic
        self.dark = dark.first_after(self.dark)
        self.halves = halves.first_after(self.halves)
        self._last = np.array(frame)
        self.depth_um.append(float(depth_um))
        self.ls.append(float(ls[0]))
        self.residual.append(float(residual[0]))

    def scan(self, calibration: Calibration) -> Scan:
        """Return the axial response of the frames so far.

        Parameters
        ----------
        calibration : Calibration
            Contains offset, slit width and scale, for the scan's slit.

        Raises
        ------
        InputError
            If there are too few depths.
        MeasurementError
            If there is no signal in contact.
        """
        systematic = self.systematic or SystematicUncertainty()
        response = axial_response(self.depth_um, self.ls, self.residual, systematic, self.dark, self.halves)
        return Scan(f"{MANUAL_SCAN}, {len(self.depth_um)} frames", response, *slit_um(calibration))


def measure_scan(stack: Stack, calibration: Calibration, *, progress: ProgressWrapper = iter) -> Scan:
    """Measure the axial response of a stack of depths.

    Parameters
    ----------
    stack : Stack
        Raw frames with their depths.
    calibration : Calibration
        Contains the bundle section and the scale.
    progress : callable
        Wraps the iterable of frame indices, for instance with a progress bar.

    Raises
    ------
    InputError
        If the depths are unknown.
    CalibrationError, MeasurementError
        As :func:`napari_elsplus.measure_axial_response`.
    """
    if stack.depth_um is None:
        raise InputError(
            f"the depths of {stack.file_name} are unknown", "put NAME.depths.csv beside it, one depth per frame"
        )
    response = measure_axial_response(
        stack.planes, calibration, stack.depth_um, progress=lambda numbers, _: progress(numbers)
    )
    return Scan(stack.name, response, *slit_um(calibration))


def slit_um(calibration: Calibration) -> tuple[float | None, float | None]:
    """Return offset (as a distance) and width of the slit at the bundle, micrometres; None if a calibration lacks them.

    Examples
    --------
    >>> from napari_elsplus.instrument.calibration import Calibration
    >>> known = {"offset": {"rows": -12.0, "uncertainty_rows": 0.01}, "optics": {"um_per_px": 2.0}}
    >>> slit_um(Calibration.parse(known))
    (24.0, None)
    """
    um_per_px = calibration.um_per_px
    if um_per_px is None:
        return None, None
    offset, settings = calibration.offset, calibration.acquired_with
    width_rows = settings.slit_rows if settings is not None else None
    return (
        abs(offset.rows) * um_per_px if offset is not None else None,
        width_rows * um_per_px if width_rows is not None else None,
    )


@dataclass(frozen=True)
class DropOffs:
    """ELS+ drop-offs of several scans against a slit parameter, with the paper's curve through them.

    Attributes
    ----------
    x_um : numpy.ndarray
        (m,), increasing.
    drop_3db_um, drop_10db_um : numpy.ndarray
        (m,); NaN where the signal does not drop so far within the scan.
    fit_3db, fit_10db : SaturationFit or None
        Fits against the offset; None if there are too few scans or they do not saturate.
    """

    x_um: NDArray[np.float64]
    drop_3db_um: NDArray[np.float64]
    drop_10db_um: NDArray[np.float64]
    fit_3db: SaturationFit | None
    fit_10db: SaturationFit | None


def drop_offs(scans: Sequence[Scan], against: SlitParameter | str) -> DropOffs:
    """Collect the ELS+ drop-offs of scans against a slit parameter, and fit the paper's saturating curve.

    Parameters
    ----------
    scans : sequence of Scan
        Those of unknown slit are left out.
    against : SlitParameter or str
        Slit offset, which is fitted, or slit width.

    Raises
    ------
    InputError
        If no scan's slit is known.
    """
    against = SlitParameter(against)
    known = [(scan.offset_um if against is SlitParameter.OFFSET else scan.slit_um, scan.response) for scan in scans]
    rows = sorted((x, one.els_3db.um, one.els_10db.um) for x, one in known if x is not None)
    if not rows:
        raise InputError(f"no scan's {against.value} is known", "calibrate the offset, and give the slit width")
    x, three, ten = np.array(rows, np.float64).T
    fits = [_fit(x, drop) if against is SlitParameter.OFFSET else None for drop in (three, ten)]
    return DropOffs(x, three, ten, *fits)


def _fit(x_um: NDArray[np.float64], drop_um: NDArray[np.float64]) -> SaturationFit | None:
    there = np.isfinite(drop_um)
    if len(np.unique(x_um[there])) < MIN_SCANS_FOR_FIT:
        return None
    try:
        return fit_saturation(x_um[there], drop_um[there])
    except MeasurementError:  # the plot then shows the points alone
        return None


def simulated_scan(
    offset_um: float = 29.0, slit_um: float = 2.9, *, depth_um: NDArray[np.float64] | None = None, seed: int = 0
) -> tuple[Stack, Calibration]:
    """Simulate an axial scan of a stained plate; frames are rendered when they are read.

    Parameters
    ----------
    offset_um, slit_um, depth_um, seed
        As of :func:`~napari_elsplus.workflows.simulated.simulate_axial_scan`.

    Returns
    -------
    tuple
        Stack of raw frames with its depths, and its calibration.
    """
    scan = simulate_axial_scan(offset_um=offset_um, slit_um=slit_um, depth_um=depth_um, seed=seed)
    assert scan.calibration.background is not None
    planes = LazyPlanes(scan.render, (scan.count, *scan.calibration.background.shape), np.dtype(np.uint8))
    um_per_px = scan.truth["um_per_px"]
    name = f"simulated, offset {offset_um:g} µm, slit {scan.truth['slit_rows'] * um_per_px:.1f} µm"
    return Stack(name, planes, {"um_per_px": um_per_px}, depth_um=scan.depth_um), scan.calibration


def axial_script(stack: Stack, calibration: Path | str | None) -> str:
    """Return a script that makes the same measurement.

    Parameters
    ----------
    stack : Stack
        Raw frames of a recording in a file.
    calibration : path-like or None
        Its calibration file.

    Raises
    ------
    InputError
        If the stack has no file.
    CalibrationError
        If the calibration has no file of its own.
    """
    body = """
response = elsplus.measure_axial_response(recording, calibration)
print(f"LS: 3 dB at {response.ls_3db.um:.1f} um, 10 dB at {response.ls_10db.um:.1f} um")
print(f"ELS+: 3 dB at {response.els_3db.um:.1f} um, 10 dB at {response.els_10db.um:.1f} um")
print(f"signal kept: {100 * response.signal_kept:.1f} %")
"""
    return recording_script(f"Axial response of {stack.file_name}.", stack, calibration, body)
