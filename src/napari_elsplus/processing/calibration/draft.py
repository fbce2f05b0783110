"""A calibration in the making: the accepted results of its steps, and the settings their frames were taken with."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, TypeVar

from napari_elsplus.instrument.calibration import AcquiredWith, Calibration, FrameSection
from napari_elsplus.instrument.optics import require_bundle_um
from napari_elsplus.processing.calibration.bundle.pair import BundlePair
from napari_elsplus.processing.calibration.galvo import GalvoMap
from napari_elsplus.processing.calibration.measurements import Background
from napari_elsplus.processing.calibration.scan.lag import ScanLag
from napari_elsplus.processing.calibration.slit_offset import SlitOffset

if TYPE_CHECKING:
    from collections.abc import Mapping

    from napari_elsplus.processing.images.sectioning import Frames

    T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Setup:
    """Settings with which frames were taken.

    Parameters
    ----------
    frame : FrameSection
        Shape of the frames, and where they begin on the sensor.
    acquired_with : AcquiredWith
        The rig's settings; empty for frames from a file.
    line_period_s, line_periods_per_frame : float, optional
        Timing.
    um_per_px : float, optional
        Nominal scale of the objective; the bundle's image gives a better one.
    """

    frame: FrameSection
    acquired_with: AcquiredWith = field(default_factory=AcquiredWith)
    line_period_s: float | None = None
    line_periods_per_frame: float | None = None
    um_per_px: float | None = None


def setup_of(frames: Frames) -> Setup:
    """Return the settings that recorded frames reveal: their shape."""
    rows, cols = frames[0].shape
    return Setup(FrameSection(shape=(rows, cols)))


@dataclass(frozen=True)
class Draft:
    """A calibration in the making. Immutable: accepting a step returns the next draft, so undoing is keeping the last.

    Parameters
    ----------
    calibration : Calibration
        Complete or not.
    found : mapping
        Result of each step that was measured here and not read from a file, by the step's key.
    outdated : mapping
        Why a step no longer holds, by its key.
    bundle_um : float, optional
        Diameter of the imaged part of the bundle in micrometres, which gives the scale; None leaves the scale as it is.
    """

    calibration: Calibration = field(default_factory=Calibration)
    found: Mapping[str, Any] = field(default_factory=dict)
    outdated: Mapping[str, str] = field(default_factory=dict)
    bundle_um: float | None = None

    @property
    def offset(self) -> SlitOffset | None:
        """The slit offset, if it was measured here."""
        return self._found("offset", SlitOffset)

    @property
    def galvo(self) -> GalvoMap | None:
        """The galvo map, if it was measured here."""
        return self._found("galvo", GalvoMap)

    @property
    def pair(self) -> BundlePair | None:
        """The bundle pair, if it was measured here."""
        return self._found("pair", BundlePair)

    @property
    def lag(self) -> ScanLag | None:
        """The scan lag, if it was measured here."""
        return self._found("lag", ScanLag)

    @property
    def background(self) -> Background | None:
        """The background, if it was measured here."""
        return self._found("background", Background)

    @property
    def um_per_px(self) -> float | None:
        """The scale, if it is known."""
        return self.calibration.um_per_px

    def with_setup(self, setup: Setup) -> Draft:
        """Return the draft with the setup of newer frames; arrays of another shape are dropped."""
        known = self.calibration
        update: dict[str, Any] = {"frame": setup.frame}
        if setup.acquired_with != AcquiredWith():
            update["acquired_with"] = setup.acquired_with
        timing = {"line_period_s": setup.line_period_s, "line_periods_per_frame": setup.line_periods_per_frame}
        given = {name: value for name, value in timing.items() if value is not None}
        if given:
            known = known.with_optics(**given)
        if known.frame is not None and known.frame.shape != setup.frame.shape:
            update |= dict.fromkeys(("background", "flat", "scan_correction", "quality"))
        return replace(self, calibration=known.model_copy(update=update))

    def with_bundle_um(self, bundle_um: float | None) -> Draft:
        """Return the draft with a diameter of the bundle, and the scale that follows if the bundle is located.

        Parameters
        ----------
        bundle_um : float or None
            In micrometres. None: unknown; a located bundle then has no scale.

        Raises
        ------
        InputError
            If no bundle has that diameter.
        """
        if bundle_um is not None:
            require_bundle_um(bundle_um)
        known, bundle = self.calibration, self.calibration.bundle
        if bundle is not None:
            known = known.with_optics(um_per_px=None if bundle_um is None else bundle_um / bundle.diameter_px)
        return replace(self, calibration=known, bundle_um=bundle_um)

    def with_timing(self, **seconds_or_periods: float | None) -> Draft:
        """Return the draft with `line_period_s` (seconds) or `line_periods_per_frame`; None where it is unknown."""
        return replace(self, calibration=self.calibration.with_optics(**seconds_or_periods))

    def with_calibration(self, calibration: Calibration) -> Draft:
        """Return the draft with another calibration."""
        return replace(self, calibration=calibration)

    def _found(self, key: str, kind: type[T]) -> T | None:
        found = self.found.get(key)
        return found if isinstance(found, kind) else None
