"""Calibration record: slit offset, galvo map, bundle views and optics of an instrument.

A calibration is measured section by section, and a section that was not measured is absent. Validation refuses NaN and
impossible numbers. Files are read and written by :mod:`napari_elsplus.io`.
"""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated, Any, Final, Literal, Self, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import AliasChoices, BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from napari_elsplus.errors import CalibrationError

FORMAT = "napari-elsplus/calibration"
"""Value of the file's key `format`."""
VERSION = 2
"""Highest version of the file format that is read."""

ARRAYS = {"background": 2, "flat": 2, "distortion": 2, "gain_map": 2, "scan_correction": 1}
"""Dimensions of the arrays, which lie in the .npz beside the file, by name."""
NEEDED_ARRAYS = ("distortion", "gain_map")
"""Those without which a calibration that was measured with them is wrong; a file with one of them has version 2."""
ARRAYS_KEY: Final = "arrays"
"""Key of a file that names the arrays that were saved beside it; a record in memory has the arrays themselves."""
DEFAULT_SLIT_ROWS: Final = 3.0
"""Slit width where it is unknown, rows: that of the presets."""
DISTORTION_SHAPE = (2, 10)
"""Row and column, and the ten coefficients of a polynomial of third degree in two variables."""

MAX_NUMBER: Final = 1e9
"""Chosen: far above any number of an instrument, and its powers are finite."""
Finite = Annotated[float, Field(ge=-MAX_NUMBER, le=MAX_NUMBER)]
Positive = Annotated[float, Field(gt=0, le=MAX_NUMBER)]
NonNegative = Annotated[float, Field(ge=0, le=MAX_NUMBER)]
Point = tuple[Finite, Finite]
AffineRows = tuple[tuple[Finite, Finite, Finite], tuple[Finite, Finite, Finite]]

CALIBRATE_COMMANDS = {
    "frame": "calibrate --line, --sweep or --bundle",
    "offset": "calibrate --line",
    "galvo": "calibrate --sweep --volts",
    "bundle": "calibrate --bundle",
    "optics": "calibrate --um-per-px or --bundle-um",
}
"""Command that measures each section, for messages."""


class Section(BaseModel):
    """Section of the calibration: immutable and validated; unknown keys are kept."""

    model_config = ConfigDict(frozen=True, extra="allow", arbitrary_types_allowed=True)


MeasuredSection = TypeVar("MeasuredSection", bound=Section)


class FrameSection(Section):
    """Recorded region: shape in (rows, cols), and sensor pixel (row, col) at which it begins."""

    shape: tuple[Annotated[int, Field(gt=0)], Annotated[int, Field(gt=0)]]
    sensor_origin: tuple[Annotated[int, Field(ge=0)], Annotated[int, Field(ge=0)]] = (0, 0)


class AcquiredWith(Section):
    """Settings of the rig during calibration; sections become stale where current settings differ."""

    rig: str | None = None
    objective: str | None = None
    slit_rows: Positive | None = None
    frame_rate_hz: Positive | None = None
    gain_db: Finite | None = None

    @property
    def slit_rows_or_default(self) -> float:
        """Slit width in rows; :data:`DEFAULT_SLIT_ROWS` where it is unknown."""
        return self.slit_rows or DEFAULT_SLIT_ROWS


class OffsetSection(Section):
    """Slit offset: row of a standing line in the residual view minus its row in the confocal view, camera rows.

    ``core_rows``, ``halo_rows`` and ``halo_share`` are the standard deviations of the line's core and halo on the
    camera and the halo's share of the light; None where the line's profile was not fitted.
    """

    rows: Finite
    uncertainty_rows: NonNegative
    tilt_deg: Finite = 0.0
    core_rows: Positive | None = None
    core_uncertainty_rows: NonNegative | None = None
    halo_rows: Positive | None = None
    halo_uncertainty_rows: NonNegative | None = None
    halo_share: Annotated[float, Field(ge=0, le=1)] | None = None
    halo_share_uncertainty: NonNegative | None = None


class GalvoSection(Section):
    """Galvo map: voltage that puts the line onto a row of the confocal view, at the confocal centre's column.

    ``lag_s`` is None where it was not measured; files of version 1 with exactly 0 are read as that. ``bow_rows`` is
    by how much the line's ends at the bundle's rim lie below its middle. ``natural_hz`` and ``damping`` are the galvo's
    resonance (Hz) and damping ratio, None unless they were fitted to the scan. In that, ``rows_off`` rows miss the slit
    by more than a quarter of it; a galvo that is too slow follows frames at ``highest_rate_hz``, 0 if it follows none.
    """

    volts_per_row: Finite
    volts_at_row_zero: Finite
    r_squared: Annotated[float, Field(ge=0, le=1)]
    rms_rows: NonNegative
    lag_s: Finite | None = None
    park_v: Finite | None = None
    volts_per_row_uncertainty: NonNegative | None = None
    volts_at_row_zero_uncertainty: NonNegative | None = None
    bow_rows: Finite | None = None
    bow_uncertainty_rows: NonNegative | None = None
    natural_hz: Positive | None = None
    damping: Positive | None = None
    rows_off: Annotated[int, Field(ge=0)] | None = None
    highest_rate_hz: NonNegative | None = None

    @field_validator("lag_s")
    @classmethod
    def _zero_was_not_measured(cls, lag_s: float | None) -> float | None:
        return lag_s or None

    @model_validator(mode="after")
    def _slope_moves_the_line(self) -> Self:
        if self.volts_per_row == 0:
            raise ValueError("volts_per_row is 0")
        return self

    def volts(self, row: float | NDArray[np.floating]) -> float | NDArray[np.floating]:
        """Return the voltage that holds the line on a row (of the recorded region, fractional)."""
        return self.volts_at_row_zero + self.volts_per_row * row

    def row(self, volts: float | NDArray[np.floating]) -> float | NDArray[np.floating]:
        """Return the row on which the line stands at a voltage in volts."""
        return (volts - self.volts_at_row_zero) / self.volts_per_row


class BundleSection(Section):
    """Bundle views: centres (row, col), half-level diameter, and view alignment.

    ``residual_to_confocal`` maps (row, col, 1) in the residual image to (row, col) in the confocal image;
    ``residual_gain`` is the brightness of the residual view over that of the confocal view. ``swept_gain`` is that in
    the light of a sweep, also where it differs too much from the lamp's to be used; None without one.
    """

    confocal_centre: Point
    residual_centre: Point
    diameter_px: Positive
    residual_to_confocal: AffineRows
    residual_gain: Annotated[float, Field(ge=0.5, le=2)] = 1.0
    residual_gain_uncertainty: NonNegative = 0.0
    swept_gain: Finite | None = None
    centre_uncertainty_px: NonNegative | None = None
    diameter_uncertainty_px: NonNegative | None = None
    alignment_uncertainty_px: NonNegative | None = None

    @property
    def offset_rows(self) -> float:
        """Row of the residual centre minus that of the confocal one: the slit offset, independent of the line."""
        return self.residual_centre[0] - self.confocal_centre[0]

    @property
    def discs(self) -> list[tuple[Point, float]]:
        """Centre and diameter in pixels of both views."""
        stretch = float(np.sqrt(abs(np.linalg.det(np.array(self.residual_to_confocal)[:, :2]))))
        return [(self.confocal_centre, self.diameter_px), (self.residual_centre, self.diameter_px / stretch)]

    @model_validator(mode="after")
    def _maps_onto_the_confocal_image(self) -> Self:
        matrix = np.array(self.residual_to_confocal)
        if not 0.5 < abs(float(np.linalg.det(matrix[:, :2]))) < 2:
            raise ValueError("residual_to_confocal is no map between two images of one bundle")
        landed = matrix @ (*self.residual_centre, 1.0)
        miss = float(np.hypot(*(landed - self.confocal_centre)))
        if miss > 0.25 * self.diameter_px:
            raise ValueError(
                f"residual_to_confocal puts the residual centre {miss:.6g} px away from the confocal centre"
            )
        return self


class OpticsSection(Section):
    """Scale and timing; each None where it is unknown."""

    um_per_px: Positive | None = None
    line_period_s: Positive | None = None
    line_periods_per_frame: Positive | None = Field(
        default=None,
        validation_alias=AliasChoices("rows_per_frame", "line_periods_per_frame"),
        serialization_alias="rows_per_frame",  # the file's key
    )


class QualitySection(Section):
    """Alignment error of the views: mean |L - R/gain| / mean L in the 90 % disc, raw and after the core filter.

    ``core_filter`` names the filter: ``gaussian``, or ``median`` where the flat field does not resolve the cores.
    """

    alignment_error: NonNegative
    alignment_error_filtered: NonNegative
    core_filter: str | None = None


def utc_now() -> str:
    """Return the present time for the key `created`: ISO 8601 in UTC, to the second."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


class Calibration(Section):
    """Calibration of a rig: the sections that were measured, background and flat field.

    Parameters
    ----------
    frame, acquired_with, offset, galvo, bundle, optics, quality : section, optional
        The measured sections.
    background : numpy.ndarray, optional
        Mean frame of the dark tube with the laser on, raw shape (rows, cols), float32 grey levels.
    flat : numpy.ndarray, optional
        Flat field of the confocal crop (n, n), float32, mean 1 inside the disc.
    distortion : numpy.ndarray, optional
        (2, 10), px: row and column by which the residual view departs from the inverse of `residual_to_confocal`, as
        coefficients of 1, r, c, r^2, rc, c^2, r^3, r^2 c, r c^2, c^3 of the position (r, c) about the confocal centre
        over half the diameter.
    scan_correction : numpy.ndarray, optional
        Rows added to the line's path while each row of the frame is exposed, shape (rows,), float32; learned at the
        frame rate of `acquired_with`.
    gain_map : numpy.ndarray, optional
        Gain of the residual view over `residual_gain` on the confocal crop (n, n), float32: 1 where it is as bright
        as on average.
    needs : tuple of str, optional
        Names of the arrays among :data:`NEEDED_ARRAYS`; with one of them the version is 2, without any it is 1.

    Examples
    --------
    >>> calibration = Calibration.parse({"offset": {"rows": -12.03, "uncertainty_rows": 0.01}})
    >>> calibration.offset.rows
    -12.03
    >>> calibration.require("bundle")  # doctest: +ELLIPSIS
    Traceback (most recent call last):
        ...
    napari_elsplus.errors.CalibrationError: the calibration has no bundle section: measure it with...
    """

    format: Literal["napari-elsplus/calibration"] = "napari-elsplus/calibration"
    version: Literal[1, 2] = 1
    created: str = Field(default_factory=utc_now)
    frame: FrameSection | None = None
    acquired_with: AcquiredWith | None = None
    offset: OffsetSection | None = None
    galvo: GalvoSection | None = None
    bundle: BundleSection | None = None
    optics: OpticsSection | None = None
    quality: QualitySection | None = None
    needs: tuple[str, ...] | None = None
    background: NDArray[np.float32] | None = Field(default=None, exclude=True, repr=False)
    flat: NDArray[np.float32] | None = Field(default=None, exclude=True, repr=False)
    distortion: NDArray[np.float32] | None = Field(default=None, exclude=True, repr=False)
    scan_correction: NDArray[np.float32] | None = Field(default=None, exclude=True, repr=False)
    gain_map: NDArray[np.float32] | None = Field(default=None, exclude=True, repr=False)

    def __eq__(self, other: object) -> bool:
        """Return True if all sections and arrays are equal."""
        if not isinstance(other, Calibration):
            return NotImplemented
        pairs = [(getattr(self, name), getattr(other, name)) for name in ARRAYS]
        same = (one is two or (one is not None and two is not None and np.array_equal(one, two)) for one, two in pairs)
        return self.content() == other.content() and all(same)

    @classmethod
    def parse(cls, content: object) -> Calibration:
        """Return a validated calibration from the content of its JSON file.

        Raises
        ------
        CalibrationError
            If it is no calibration, has a newer version, or contains NaN or impossible numbers.
        """
        own = cls.model_fields.keys() - {"version", "created"}  # which other files have, too
        if not isinstance(content, dict) or content.keys().isdisjoint(own) or content.get("format", FORMAT) != FORMAT:
            raise CalibrationError(f"this is no {FORMAT} record", "name the .json file that `calibrate` wrote")
        version = content.get("version", VERSION)
        if isinstance(version, int) and version > VERSION:
            raise CalibrationError(
                f"the calibration has version {version}, this software reads up to {VERSION}", "update napari-elsplus"
            )
        try:
            return cls.model_validate({k: v for k, v in content.items() if k not in {*ARRAYS, ARRAYS_KEY}})
        except ValidationError as error:
            raise _impossible(error, "calibration") from None

    @property
    def um_per_px(self) -> float | None:
        """Micrometres at the bundle per camera pixel; None if unknown."""
        return None if self.optics is None else self.optics.um_per_px

    @property
    def slit_rows(self) -> float:
        """Slit width with which it was acquired, rows; :data:`DEFAULT_SLIT_ROWS` where it is unknown."""
        return (self.acquired_with or AcquiredWith()).slit_rows_or_default

    @property
    def frame_period_s(self) -> float | None:
        """Frame period in seconds; None if the timing is unknown."""
        optics = self.optics
        if optics is None or optics.line_period_s is None or optics.line_periods_per_frame is None:
            return None
        return optics.line_period_s * optics.line_periods_per_frame

    def content(self) -> dict[str, Any]:
        """Return all but the arrays, ready for JSON; absent sections are left out, unknown keys are kept."""
        content = self.model_dump(mode="json", by_alias=True, exclude_none=True)
        needs = [name for name in NEEDED_ARRAYS if getattr(self, name) is not None]
        return content | {"version": 2, "needs": needs} if needs else content

    def with_view_arrays(
        self, distortion: NDArray[np.float32] | None, gain_map: NDArray[np.float32] | None
    ) -> Calibration:
        """Return the calibration with other arrays of the residual view, and the version that they need.

        Parameters
        ----------
        distortion, gain_map : numpy.ndarray or None
            As of :class:`Calibration`.
        """
        arrays = {"distortion": distortion, "gain_map": gain_map}
        needs = tuple(name for name, array in arrays.items() if array is not None)
        return self.model_copy(update=arrays | {"needs": needs or None, "version": 2 if needs else 1})

    def missing_array(self) -> str | None:
        """Return the name of an array without which this calibration is wrong, and which is absent; None if none is."""
        needs = self.needs or (NEEDED_ARRAYS[:1] if self.version == 2 else ())
        return next((name for name in needs if getattr(self, name, None) is None), None)

    def require(self, *sections: str) -> None:
        """Raise a `CalibrationError` that names the first absent one of some sections and the command to measure it."""
        for name in sections:
            if getattr(self, name) is None:
                remedy = f"measure it with `{CALIBRATE_COMMANDS.get(name, 'calibrate')}`, or in the Calibration panel"
                raise CalibrationError(f"the calibration has no {name} section", remedy)

    @property
    def measured_offset(self) -> OffsetSection:
        """Slit offset; a `CalibrationError` if it was not measured."""
        return self._measured("offset", self.offset)

    @property
    def measured_galvo(self) -> GalvoSection:
        """Galvo map; a `CalibrationError` if it was not measured."""
        return self._measured("galvo", self.galvo)

    @property
    def measured_bundle(self) -> BundleSection:
        """Bundle views; a `CalibrationError` if they were not measured."""
        return self._measured("bundle", self.bundle)

    @property
    def measured_um_per_px(self) -> float:
        """Micrometres at the bundle per camera pixel; a `CalibrationError` if unknown."""
        self.require("optics")
        if self.um_per_px is None:
            raise CalibrationError(
                "the calibration has no um_per_px", "give it with `calibrate --um-per-px` or --bundle-um"
            )
        return self.um_per_px

    def _measured(self, name: str, section: MeasuredSection | None) -> MeasuredSection:
        self.require(name)
        assert section is not None
        return section

    def with_galvo(self, **changes: float | None) -> Calibration:
        """Return the calibration with other values of the galvo section; a `CalibrationError` if there is none."""
        return self.model_copy(update={"galvo": self.measured_galvo.model_copy(update=changes)})

    def with_optics(self, **changes: float | None) -> Calibration:
        """Return the calibration with `changes` of the optics section; a `CalibrationError` if one is impossible."""
        try:
            optics = OpticsSection.model_validate({**dict(self.optics or ()), **changes})
        except ValidationError as error:
            raise _impossible(error, "optics") from None
        return self.model_copy(update={"optics": optics})


def _impossible(error: ValidationError, section: str) -> CalibrationError:
    """Return the error of a value that a section cannot have."""
    first = error.errors()[0]
    where = ".".join(str(part) for part in first["loc"]) or section
    value = "" if isinstance(first["input"], dict) else f" (value {first['input']!r:.60})"
    return CalibrationError(
        f"{where}: {first['msg'].removeprefix('Value error, ')}{value}", "measure this section again"
    )
