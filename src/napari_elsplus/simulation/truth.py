"""What is known of a simulated recording: its calibration, its geometry, where the probe was."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from napari_elsplus.instrument.calibration import (
    AcquiredWith,
    BundleSection,
    Calibration,
    FrameSection,
    GalvoSection,
    OffsetSection,
    OpticsSection,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.simulation.model.instrument import Instrument
    from napari_elsplus.simulation.specimen.trajectories import Trajectory

PARK_CLEARANCE_UM = 100.0
"""Distance between the parked line and the lit bundle: a halo's width."""


def residual_to_confocal(instrument: Instrument) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Affine map (row, col, 1) in the residual image -> (row, col) in the confocal image."""
    back = np.linalg.inv(instrument.right.matrix)
    shift = np.array(instrument.left_centre) - back @ instrument.right_centre
    first, second = ((float(a), float(b), float(c)) for (a, b), c in zip(back, shift, strict=True))
    return first, second


def park_volts(instrument: Instrument) -> float:
    """Voltage at which the line clears the lit bundle on its upper side."""
    clear = instrument.diameter_px / 2 + instrument.optics.rows(PARK_CLEARANCE_UM)
    return instrument.volts_at_row_zero + instrument.volts_per_row * (instrument.left_centre[0] - clear)


def true_calibration(instrument: Instrument, background: NDArray[np.float32] | None = None) -> Calibration:
    """Calibration that a perfect measurement of the instrument would give.

    Parameters
    ----------
    instrument : Instrument
        What was simulated.
    background : numpy.ndarray, optional
        Mean frame of the dark tube (rows, cols).

    Examples
    --------
    >>> from napari_elsplus.simulation.model.instrument import Instrument
    >>> true_calibration(Instrument.of("240hz", offset_um=-29)).offset.rows
    -21.75
    """
    optics = instrument.optics
    return Calibration(
        frame=FrameSection(shape=instrument.frame_shape, sensor_origin=instrument.preset.sensor_origin),
        acquired_with=AcquiredWith(
            rig="simulated",
            objective=instrument.preset.objective,
            slit_rows=instrument.slit_rows,
            frame_rate_hz=optics.frame_rate_hz,
            gain_db=0.0,
        ),
        offset=OffsetSection(rows=instrument.offset_rows, uncertainty_rows=0.0, tilt_deg=instrument.line_tilt_deg),
        galvo=GalvoSection(
            volts_per_row=instrument.volts_per_row,
            volts_at_row_zero=instrument.volts_at_row_zero,
            r_squared=1.0,
            rms_rows=0.0,
            park_v=park_volts(instrument),
        ),
        bundle=BundleSection(
            confocal_centre=instrument.left_centre,
            residual_centre=instrument.right_centre,
            diameter_px=instrument.diameter_px,
            residual_to_confocal=residual_to_confocal(instrument),
            residual_gain=instrument.right.gain,
            residual_gain_uncertainty=0.0,
        ),
        optics=OpticsSection(
            um_per_px=optics.um_per_px,
            line_period_s=optics.line_period_s,
            line_periods_per_frame=optics.line_periods_per_frame,
        ),
        background=background,
    )


def geometry(instrument: Instrument) -> dict[str, Any]:
    """Numbers of the instrument under short names, ready for JSON.

    ``diameter_px`` is that of the circle of core centres; ``right_to_bundle`` takes a vector from the right image's
    centre to the left image's scale and orientation.
    """
    return {
        "left": list(instrument.left_centre),
        "right": list(instrument.right_centre),
        "diameter_px": instrument.diameter_px,
        "offset_rows": instrument.offset_rows,
        "slit_rows": instrument.slit_rows,
        "tilt": float(np.tan(np.deg2rad(instrument.line_tilt_deg))),
        "gain": instrument.right.gain,
        "right_to_bundle": np.linalg.inv(instrument.right.matrix).tolist(),
        "volt_per_row": instrument.volts_per_row,
        "volt_0": instrument.volts_at_row_zero,
        "um_per_px": instrument.optics.um_per_px,
        "line_period_s": instrument.optics.line_period_s,
        "rows_per_frame": instrument.optics.line_periods_per_frame,
    }


def motion(instrument: Instrument, trajectory: Trajectory, frames: int) -> dict[str, Any]:
    """Positions of the probe in camera pixels (row, col), ready for JSON.

    ``positions``: at the start of each frame and at the end of the last; ``positions_mid``: when the middle row of the
    confocal bundle is read, the moment to which a track's positions belong.
    """
    optics = instrument.optics

    def at(periods: NDArray[np.float64]) -> list[list[float]]:
        found: list[list[float]] = (
            trajectory.positions_um(periods * optics.frame_period_s) / optics.um_per_px
        ).tolist()
        return found

    starts = np.arange(frames + 1, dtype=np.float64)
    middle = instrument.left_centre[0] / optics.line_periods_per_frame
    return {"frames": frames, "positions": at(starts), "positions_mid": at(starts[:-1] + middle)}
