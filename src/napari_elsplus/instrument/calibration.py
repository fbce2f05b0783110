"""The one record that everything downstream reads: where the line, the mirror and the two images are.

A calibration is measured section by section (slit offset, galvo map, bundle pair, optics), and a section that was not
measured is absent. The record validates itself: no number in it is NaN or impossible. Files are read and written by
:mod:`napari_elsplus.io`.
"""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import AliasChoices, BaseModel, ConfigDict, Field, ValidationError, model_validator

from napari_elsplus.errors import CalibrationError

FORMAT = "napari-elsplus/calibration"
VERSION = 1

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Point = tuple[Finite, Finite]
AffineRows = tuple[tuple[Finite, Finite, Finite], tuple[Finite, Finite, Finite]]

CALIBRATE_COMMANDS = {
    "frame": "calibrate --line, --sweep or --bundle",
    "offset": "calibrate --line",
    "galvo": "calibrate --sweep --volts",
    "bundle": "calibrate --bundle",
    "optics": "calibrate --um-per-px or --bundle-um",
}


class Section(BaseModel):
    """A part of the calibration: immutable, validated, and faithful to keys that it does not know."""

    model_config = ConfigDict(frozen=True, extra="allow", arbitrary_types_allowed=True)


class FrameSection(Section):
    """The recorded region: its shape, and the sensor pixel where it begins."""

    shape: tuple[Annotated[int, Field(gt=0)], Annotated[int, Field(gt=0)]]
    sensor_origin: tuple[Annotated[int, Field(ge=0)], Annotated[int, Field(ge=0)]] = (0, 0)


class AcquiredWith(Section):
    """The rig's settings while it was calibrated; where they differ later, sections are stale."""

    rig: str | None = None
    objective: str | None = None
    slit_rows: Positive | None = None
    frame_rate_hz: Positive | None = None
    gain_db: Finite | None = None


class OffsetSection(Section):
    """Row of a standing line in the right image minus its row in the left one."""

    rows: Finite
    uncertainty_rows: NonNegative
    tilt_deg: Finite = 0.0


class GalvoSection(Section):
    """Volts that put the line onto a row of the left image, at the confocal centre's column."""

    volts_per_row: Finite
    volts_at_row_zero: Finite
    r_squared: Annotated[float, Field(ge=0, le=1)]
    rms_rows: NonNegative
    lag_s: Finite = 0.0
    park_v: Finite | None = None
    volts_per_row_uncertainty: NonNegative | None = None
    volts_at_row_zero_uncertainty: NonNegative | None = None

    @model_validator(mode="after")
    def _slope_moves_the_line(self) -> Self:
        if self.volts_per_row == 0:
            raise ValueError("volts_per_row is 0")
        return self

    def volts(self, row: float | NDArray[np.floating]) -> float | NDArray[np.floating]:
        """Volts that hold the line on a row."""
        return self.volts_at_row_zero + self.volts_per_row * row

    def row(self, volts: float | NDArray[np.floating]) -> float | NDArray[np.floating]:
        """Row on which the line stands at a voltage."""
        return (volts - self.volts_at_row_zero) / self.volts_per_row


class BundleSection(Section):
    """The pair of bundle images: centres (row, col), half-level diameter, and right mapped onto left.

    ``residual_to_confocal`` maps (row, col, 1) in the residual image to (row, col) in the confocal image;
    ``residual_gain`` is the brightness of the right view over the left.
    """

    confocal_centre: Point
    residual_centre: Point
    diameter_px: Positive
    residual_to_confocal: AffineRows
    residual_gain: Annotated[float, Field(ge=0.5, le=2)] = 1.0
    residual_gain_uncertainty: NonNegative = 0.0
    centre_uncertainty_px: NonNegative | None = None
    diameter_uncertainty_px: NonNegative | None = None
    alignment_uncertainty_px: NonNegative | None = None

    @model_validator(mode="after")
    def _maps_onto_the_confocal_image(self) -> Self:
        matrix = np.array(self.residual_to_confocal)
        if not 0.5 < abs(float(np.linalg.det(matrix[:, :2]))) < 2:
            raise ValueError("residual_to_confocal is no map between two images of one bundle")
        landed = matrix @ (*self.residual_centre, 1.0)
        miss = float(np.hypot(*(landed - self.confocal_centre)))
        if miss > 0.25 * self.diameter_px:
            raise ValueError(
                f"residual_to_confocal puts the residual centre {miss:.1f} px away from the confocal centre"
            )
        return self


class OpticsSection(Section):
    """Scale and timing; each may be unknown."""

    um_per_px: Positive | None = None
    line_period_s: Positive | None = None
    line_periods_per_frame: Positive | None = Field(
        default=None,
        validation_alias=AliasChoices("rows_per_frame", "line_periods_per_frame"),
        serialization_alias="rows_per_frame",  # the file's key
    )


class QualitySection(Section):
    """How well the two views cancel: mean |L - R/gain| / mean L in the 90 % disc, raw and after the core filter."""

    alignment_error: NonNegative
    alignment_error_filtered: NonNegative


def _now() -> str:
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


class Calibration(Section):
    """Everything that is known of a rig, as far as it was measured.

    Parameters
    ----------
    frame, acquired_with, offset, galvo, bundle, optics, quality : section, optional
        The measured sections.
    background : numpy.ndarray, optional
        Mean frame of the dark tube with the laser on, raw shape (rows, cols), float32 grey levels.
    flat : numpy.ndarray, optional
        Flat field of the confocal crop (n, n), float32, mean 1 inside the disc.

    Examples
    --------
    >>> calibration = Calibration.parse({"offset": {"rows": -12.03, "uncertainty_rows": 0.01}})
    >>> calibration.offset.rows
    -12.03
    >>> calibration.require("bundle")
    Traceback (most recent call last):
        ...
    napari_elsplus.errors.CalibrationError: the calibration has no bundle section: measure it with `calibrate --bundle`
    """

    format: Literal["napari-elsplus/calibration"] = "napari-elsplus/calibration"
    version: Literal[1] = 1
    created: str = Field(default_factory=_now)
    frame: FrameSection | None = None
    acquired_with: AcquiredWith | None = None
    offset: OffsetSection | None = None
    galvo: GalvoSection | None = None
    bundle: BundleSection | None = None
    optics: OpticsSection | None = None
    quality: QualitySection | None = None
    background: NDArray[np.float32] | None = Field(default=None, exclude=True, repr=False)
    flat: NDArray[np.float32] | None = Field(default=None, exclude=True, repr=False)

    @classmethod
    def parse(cls, content: object) -> Calibration:
        """Validate what was read from a calibration's JSON.

        Raises
        ------
        CalibrationError
            If it is no calibration, comes from a newer version, or holds NaN or impossible numbers.
        """
        if not isinstance(content, dict) or content.get("format", FORMAT) != FORMAT:
            raise CalibrationError(f"this is no {FORMAT} record", "name the .json file that `calibrate` wrote")
        version = content.get("version", VERSION)
        if isinstance(version, int) and version > VERSION:
            raise CalibrationError(
                f"the calibration has version {version}, this software reads up to {VERSION}", "update napari-elsplus"
            )
        try:
            return cls.model_validate({k: v for k, v in content.items() if k not in {"background", "flat"}})
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(str(part) for part in first["loc"]) or "calibration"
            value = "" if isinstance(first["input"], dict) else f" (value {first['input']!r:.60})"
            raise CalibrationError(
                f"{where}: {first['msg'].removeprefix('Value error, ')}{value}", "measure this section again"
            ) from None

    @property
    def um_per_px(self) -> float | None:
        """Micrometres at the bundle for one camera pixel, where they are known."""
        return None if self.optics is None else self.optics.um_per_px

    @property
    def frame_period_s(self) -> float | None:
        """Seconds from one frame to the next, where the timing is known."""
        optics = self.optics
        if optics is None or optics.line_period_s is None or optics.line_periods_per_frame is None:
            return None
        return optics.line_period_s * optics.line_periods_per_frame

    def content(self) -> dict[str, Any]:
        """Everything but the arrays, ready for JSON; absent sections are left out, unknown keys are kept."""
        return self.model_dump(mode="json", by_alias=True, exclude_none=True)

    def require(self, *sections: str) -> None:
        """Make sure that sections were measured.

        Raises
        ------
        CalibrationError
            Naming the first that is absent and how to measure it.
        """
        for name in sections:
            if getattr(self, name) is None:
                how = CALIBRATE_COMMANDS.get(name, "calibrate")
                raise CalibrationError(f"the calibration has no {name} section", f"measure it with `{how}`")

    def stale_sections(self, settings: AcquiredWith, frame: FrameSection | None = None) -> dict[str, str]:
        """Sections that no longer hold, each with the reason, when the rig runs with other settings."""
        stale: dict[str, str] = {}
        if frame is not None and self.frame is not None and frame.shape != self.frame.shape:
            reason = f"frame {self.frame.shape} became {frame.shape}"
            stale |= dict.fromkeys(("offset", "galvo", "bundle", "background"), reason)
        if self.acquired_with is None:
            return stale
        affected = {
            "objective": ("offset", "galvo", "bundle", "optics", "background"),
            "slit_rows": ("background",),
            "gain_db": ("background",),
            "frame_rate_hz": ("optics",),
        }
        for name, sections in affected.items():
            then, now = getattr(self.acquired_with, name), getattr(settings, name)
            if then is not None and now is not None and then != now:
                stale |= dict.fromkeys(sections, f"{name} was {then}, is {now}")
        return {name: reason for name, reason in stale.items() if getattr(self, name) is not None}
