"""Ground truth of a simulated recording: calibration, geometry, positions of the probe."""

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
from napari_elsplus.instrument.optics import PARK_CLEARANCE_UM
from napari_elsplus.simulation.rendering.views import views

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_elsplus.simulation.model.instrument import Instrument
    from napari_elsplus.simulation.specimen.trajectories import Trajectory


def residual_to_confocal(instrument: Instrument) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Return an instrument's affine map from (row, col, 1) in the residual view to (row, col) in the confocal view.

    Where a view is distorted, it is the map of least squares over all cores.
    """
    if instrument.imperfections.distorts:
        _, left, right = views(instrument)
        from_right = np.stack([right.rows_px, right.cols_px, np.ones(len(right.rows_px))], axis=1)
        to_left = np.stack([left.rows_px, left.cols_px], axis=1)
        fitted = np.linalg.lstsq(from_right, to_left, rcond=None)[0].T
        back, shift = fitted[:, :2], fitted[:, 2]
    else:
        back = np.linalg.inv(instrument.residual_view.matrix)
        shift = np.array(instrument.confocal_centre) - back @ instrument.residual_centre
    first, second = ((float(a), float(b), float(c)) for (a, b), c in zip(back, shift, strict=True))
    return first, second


def park_volts(instrument: Instrument) -> float:
    """Return the voltage, V, at which an instrument's line is parked above the bundle."""
    clear = instrument.diameter_px / 2 + instrument.optics.rows(PARK_CLEARANCE_UM)
    return instrument.volts_at_row_zero + instrument.volts_per_row * (instrument.confocal_centre[0] - clear)


def true_calibration(instrument: Instrument, background: NDArray[np.float32] | None = None) -> Calibration:
    """Return the true calibration of an instrument, with zero uncertainties.

    Parameters
    ----------
    instrument : Instrument
        The simulated instrument.
    background : numpy.ndarray, optional
        (rows, cols) mean frame in a dark tube; without it the calibration has no background.

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
        offset=OffsetSection(
            rows=instrument.offset_rows,
            uncertainty_rows=0.0,
            tilt_deg=instrument.line_tilt_deg,
            core_rows=optics.rows(float(np.hypot(instrument.line.core_um, instrument.bundle.spot_um))),
            core_uncertainty_rows=0.0,
            halo_rows=optics.rows(float(np.hypot(instrument.line.halo_um, instrument.bundle.spot_um))),
            halo_uncertainty_rows=0.0,
            halo_share=instrument.line.halo_share,
            halo_share_uncertainty=0.0,
        ),
        galvo=GalvoSection(
            volts_per_row=instrument.volts_per_row,
            volts_at_row_zero=instrument.volts_at_row_zero,
            r_squared=1.0,
            rms_rows=0.0,
            park_v=park_volts(instrument),
        ),
        bundle=BundleSection(
            confocal_centre=instrument.confocal_centre,
            residual_centre=instrument.residual_centre,
            diameter_px=instrument.diameter_px,
            residual_to_confocal=residual_to_confocal(instrument),
            residual_gain=instrument.residual_view.gain,
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
    """Return the geometry of an instrument for the truth files, ready for JSON.

    ``diameter_px`` is that of the circle of core centres; ``right_to_bundle`` maps a vector from the residual view's
    centre to scale and orientation of the confocal view.
    """
    return {
        "left": list(instrument.confocal_centre),
        "right": list(instrument.residual_centre),
        "diameter_px": instrument.diameter_px,
        "offset_rows": instrument.offset_rows,
        "slit_rows": instrument.slit_rows,
        "tilt": float(np.tan(np.deg2rad(instrument.line_tilt_deg))),
        "gain": instrument.residual_view.gain,
        "right_to_bundle": np.linalg.inv(instrument.residual_view.matrix).tolist(),
        "volt_per_row": instrument.volts_per_row,
        "volt_0": instrument.volts_at_row_zero,
        "um_per_px": instrument.optics.um_per_px,
        "line_period_s": instrument.optics.line_period_s,
        "rows_per_frame": instrument.optics.line_periods_per_frame,
        "imperfections": instrument.imperfections.changed,
    }


def motion(instrument: Instrument, trajectory: Trajectory, frames: int) -> dict[str, Any]:
    """Return the positions of the probe (row, col) in camera pixels for the truth files, ready for JSON.

    ``positions``: at the start of each frame and at the end of the last; ``positions_mid``: when the middle row of the
    confocal view is read, the time to which a track's positions refer.

    Parameters
    ----------
    instrument : Instrument
        The simulated instrument.
    trajectory : Trajectory
        Path of the probe.
    frames : int
        Number of frames.
    """
    optics = instrument.optics

    def at(periods: NDArray[np.float64]) -> list[list[float]]:
        found: list[list[float]] = (
            trajectory.positions_um(periods * optics.frame_period_s) / optics.um_per_px
        ).tolist()
        return found

    starts = np.arange(frames + 1, dtype=np.float64)
    middle = instrument.confocal_centre[0] / optics.line_periods_per_frame
    return {"frames": frames, "positions": at(starts), "positions_mid": at(starts[:-1] + middle)}
