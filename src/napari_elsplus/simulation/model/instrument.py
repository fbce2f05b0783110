"""Parameters of the simulated instrument: optics, slit, views of the bundle, light, noise, galvo map."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import isfinite
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from napari_elsplus.errors import InputError
from napari_elsplus.instrument.calibration import MAX_NUMBER
from napari_elsplus.instrument.optics import PIXEL_PITCH_UM, SENSOR_SHAPE, Optics, Preset, preset
from napari_elsplus.simulation.model.axial_response import LINE_MODELS, LineModel
from napari_elsplus.simulation.model.bundle import Bundle
from napari_elsplus.simulation.model.imperfections import IDEAL, Imperfections

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

REFERENCE_SLIT_ROWS: Final = 3
"""Slit width, rows, at which `Instrument.light_dn` holds: the paper's 2.9 um; a wider slit gathers more."""
_VOLTS_PER_SENSOR_PX: Final = 0.00126
"""Galvo map of the paper, V per sensor row."""
_VOLTS_AT_SENSOR_ROW_0: Final = -0.459
"""Galvo map of the paper, V at sensor row 0."""
_MAGNIFICATION: Final = 3.778
"""Magnification of the paper's 120 Hz preset, for which its galvo map holds: 3.63 um pixels, 0.9608 um per row."""

_S_CURVE_REACH: Final = 1.5
"""Radii of the bundle from its middle beyond which the galvo's deviation stays constant: the parked line; chosen."""


@dataclass(frozen=True, slots=True)
class ResidualView:
    """Gain, rotation and scale of the residual view relative to the confocal view."""

    gain: float = 0.95
    rotation_deg: float = 0.15
    scale: float = 1.001

    def __post_init__(self) -> None:
        for name, low, high in (("gain", 0.5, 2.0), ("rotation_deg", -10.0, 10.0), ("scale", 0.9, 1.1)):
            value = getattr(self, name)
            if not low <= value <= high:
                raise InputError(f"the residual view's {name} is {value}", f"give {low:g} to {high:g}")

    @property
    def matrix(self) -> np.ndarray[Any, np.dtype[np.float64]]:
        """(2, 2) matrix from a core's vector (row, col) about the confocal centre to that about the residual centre."""
        angle = np.deg2rad(self.rotation_deg)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        return np.asarray(self.scale * turn)


@dataclass(frozen=True, slots=True)
class Instrument:
    """Parameters that determine a raw frame, except scene, motion and scan.

    Parameters
    ----------
    preset : Preset
        Camera region, objective, scale and timing.
    slit_rows : float
        Exposure in line periods: the rolling slit's width.
    offset_rows : float
        Row of a standing line in the right image minus its row in the left one; negative: the residual lies higher.
    bundle : Bundle
        The fibre bundle.
    line : LineModel
        The laser line and its spread.
    residual_view : ResidualView
        The residual view's gain, rotation and scale.
    line_tilt_deg : float
        Tilt of the line against the camera's rows, positive: its right end is lower.
    light_dn : float
        Grey levels of an in-focus plane of brightness 1 in the confocal view, through a slit of three rows.
    electrons_per_dn, read_noise_e, black_dn : float
        The camera's gain, read noise (rms) and black level.
    autofluorescence : float
        Brightness of the bundle itself.
    volts_per_row, volts_at_row_zero : float
        Galvo map: voltage at which the line lies on a row of the confocal view.
    imperfections : Imperfections
        Departures from the ideal instrument.

    Raises
    ------
    InputError
        If the optics are impossible: no light, a slit wider than the bundle, an offset beyond it, images that do not
        fit the frame.

    Examples
    --------
    >>> instrument = Instrument.of("240hz", offset_um=-29)
    >>> round(instrument.offset_rows, 2), [round(x, 1) for x in instrument.confocal_centre]
    (-21.75, [273.1, 332.3])
    >>> Instrument.of("240hz", offset_um=700)
    Traceback (most recent call last):
        ...
    napari_elsplus.errors.InputError: the slit offset is 700.0 um, beyond the bundle of 620.0 um: make it smaller
    """

    preset: Preset
    slit_rows: float = 3.0
    offset_rows: float = -30.0
    bundle: Bundle = field(default_factory=Bundle)
    line: LineModel = LINE_MODELS["a"]
    residual_view: ResidualView = field(default_factory=ResidualView)
    line_tilt_deg: float = 0.2
    light_dn: float = 80.0
    electrons_per_dn: float = 40.0
    read_noise_e: float = 12.0
    black_dn: float = 4.0
    autofluorescence: float = 0.04
    volts_per_row: float = _VOLTS_PER_SENSOR_PX
    volts_at_row_zero: float = _VOLTS_AT_SENSOR_ROW_0
    imperfections: Imperfections = IDEAL

    def __post_init__(self) -> None:
        Imperfections.require(self.imperfections)
        self._refuse_impossible_numbers()
        if self.slit_um > self.bundle.diameter_um:
            raise InputError(
                f"the slit is {self.slit_um:.1f} um wide, the bundle {self.bundle.diameter_um:.1f} um", "narrow it"
            )
        if abs(self.offset_um) > self.bundle.diameter_um:
            raise InputError(
                f"the slit offset is {self.offset_um:.1f} um, beyond the bundle of {self.bundle.diameter_um:.1f} um",
                "make it smaller",
            )
        rows, cols = self.preset.frame_shape
        tall, wide = self.diameter_px + abs(self.offset_rows), self.diameter_px * max(1.0, self.residual_view.scale)
        if tall > rows or 2 * wide > cols:
            raise InputError(
                f"two bundle images of {self.diameter_px:.0f} px, {self.offset_rows:.0f} rows apart, "
                f"do not fit a frame of {rows} x {cols}",
                "choose a smaller offset or another preset",
            )

    def _refuse_impossible_numbers(self) -> None:
        for name in ("slit_rows", "light_dn", "electrons_per_dn"):
            value = getattr(self, name)
            if not (isfinite(value) and value > 0):
                raise InputError(f"{name} is {value}", "it must be a positive number")
        for name in ("read_noise_e", "black_dn", "autofluorescence"):
            value = getattr(self, name)
            if not (isfinite(value) and value >= 0):
                raise InputError(f"{name} is {value}", "it must be zero or more")
        for name in ("offset_rows", "line_tilt_deg", "volts_per_row", "volts_at_row_zero"):
            if not isfinite(getattr(self, name)):
                raise InputError(f"{name} is {getattr(self, name)}", "it must be a number")
        if self.volts_per_row == 0:
            raise InputError("volts_per_row is 0", "then the galvo cannot move the line")

    @classmethod
    def of(
        cls,
        preset_name: str,
        *,
        slit_um: float | None = None,
        offset_um: float = -29.0,
        rate_hz: float | None = None,
        **changes: Any,
    ) -> Instrument:
        """Return an instrument with one of the camera's presets, slit and offset in micrometres at the bundle.

        Parameters
        ----------
        preset_name : str
            ``"120hz"`` or ``"240hz"``.
        slit_um : float, optional
            Slit width, rounded to whole rows; three rows by default.
        offset_um : float
            Signed slit offset; set by the galvo, so that it need not be whole rows.
        rate_hz : float, optional
            A lower frame rate at the same line period.
        **changes
            Other fields of the record.
        """
        if slit_um is not None and not (isfinite(slit_um) and slit_um > 0):
            raise InputError(f"the slit is {slit_um} um wide", "it must be a positive number")
        chosen = preset(preset_name)
        if rate_hz is not None:
            chosen = replace(chosen, optics=_slowed(chosen, rate_hz))
        optics = chosen.optics
        slit_rows = REFERENCE_SLIT_ROWS if slit_um is None else max(1, round(optics.rows(slit_um)))
        # The galvo map is independent of the objective on the middle row of the sensor.
        middle = SENSOR_SHAPE[0] / 2
        volts_middle = _VOLTS_AT_SENSOR_ROW_0 + _VOLTS_PER_SENSOR_PX * middle
        volts_per_row = _VOLTS_PER_SENSOR_PX * optics.um_per_px / (PIXEL_PITCH_UM / _MAGNIFICATION)
        fields: dict[str, Any] = {
            "slit_rows": float(slit_rows),
            "offset_rows": optics.rows(offset_um),
            "volts_per_row": volts_per_row,
            "volts_at_row_zero": volts_middle - volts_per_row * (middle - chosen.sensor_origin[0]),
        }
        return cls(chosen, **(fields | changes))

    @property
    def optics(self) -> Optics:
        """Scale and timing."""
        return self.preset.optics

    @property
    def frame_shape(self) -> tuple[int, int]:
        """Rows and columns of a raw frame."""
        return self.preset.frame_shape

    @property
    def slit_um(self) -> float:
        """Slit width at the bundle."""
        return self.optics.um(self.slit_rows)

    @property
    def offset_um(self) -> float:
        """Signed slit offset at the bundle."""
        return self.optics.um(self.offset_rows)

    @property
    def diameter_px(self) -> float:
        """Diameter of the circle of core centres in the confocal view, px."""
        return self.optics.rows(self.bundle.diameter_um)

    @property
    def confocal_centre(self) -> tuple[float, float]:
        """Row and column of the centre of the confocal view: the two are centred on the frame, off the pixel grid."""
        rows, cols = self.frame_shape
        return (rows - 1) / 2 - self.offset_rows / 2 + 0.7, cols / 4 + 0.3

    @property
    def residual_centre(self) -> tuple[float, float]:
        """Row and column of the centre of the residual view."""
        rows, cols = self.confocal_centre
        return rows + self.offset_rows, cols + self.frame_shape[1] / 2 - 0.85

    def line_row(self, volts: ArrayLike) -> NDArray[np.float64]:
        """Return the row of the confocal view on which the line lies, for galvo positions in volts.

        The galvo map is linear but for ``galvo-s-curve``: a cubic that is zero at the bundle's middle and rim.
        """
        row = (np.asarray(volts, np.float64) - self.volts_at_row_zero) / self.volts_per_row
        peak_rows = self.imperfections.galvo_s_curve_rows
        if not peak_rows:
            return row
        u = np.clip((row - self.confocal_centre[0]) / (self.diameter_px / 2), -_S_CURVE_REACH, _S_CURVE_REACH)
        return np.asarray(row + peak_rows * 1.5 * np.sqrt(3) * (u - u**3))

    def with_gain_db(self, gain_db: float) -> Instrument:
        """Return the instrument with the camera's gain raised: more grey levels, fewer electrons per level."""
        factor = 10 ** (gain_db / 20)
        return replace(self, light_dn=self.light_dn * factor, electrons_per_dn=self.electrons_per_dn / factor)


def _slowed(chosen: Preset, rate_hz: float) -> Optics:
    fastest, slowest = chosen.optics.frame_rate_hz, 1 / (MAX_NUMBER * chosen.optics.line_period_s)
    if not slowest < rate_hz <= fastest * (1 + 1e-6):
        raise InputError(
            f"{rate_hz} frames per second asked of the {chosen.name} preset",
            f"give at most {fastest:.4g}, more than {slowest:.2g}",
        )
    return chosen.optics.at_rate(rate_hz)
