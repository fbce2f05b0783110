"""Light that each core receives: how far the line is from it, and how much of the line's light it collects."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from napari_elsplus.processing.compiled import kernel
from napari_elsplus.simulation.model.axial_response import NARROW_SLIT
from napari_elsplus.simulation.model.bells import REACH, bell, error_function

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Values = NDArray[np.float32]


@kernel
def place_line(
    offset_um: Floats,
    smear_um: Floats,
    camera_rows: Floats,
    rows_um: Floats,
    below_um: Floats,
    lag_rows: Floats,
    speed: Floats,
    um_per_px: float,
    centre_row: float,
    slit_um: float,
) -> None:
    """Write how far the line is from each core, and by how much it moves, while the core's row is exposed.

    Parameters
    ----------
    offset_um, smear_um : numpy.ndarray
        (cores,) output: line minus core, and way of the line during the exposure.
    camera_rows, rows_um : numpy.ndarray
        (cores,) camera row of each core, and its position about the centre of the bundle.
    below_um : numpy.ndarray
        (cores,) by how much the line is lower at the core than at its middle.
    lag_rows, speed : numpy.ndarray
        (rows,) line minus row at each camera row, and rows per row by which it moves.
    um_per_px, centre_row, slit_um : float
        Scale, row of the confocal view's centre, slit width.
    """
    last = len(lag_rows) - 1
    for n in range(len(offset_um)):
        row = min(max(camera_rows[n], 0.0), float(last))
        r = min(int(row), last - 1)
        f = row - r
        lag = lag_rows[r] + f * (lag_rows[r + 1] - lag_rows[r])
        offset_um[n] = (camera_rows[n] + lag - centre_row) * um_per_px - rows_um[n] + below_um[n]
        smear_um[n] = slit_um * (speed[r] + f * (speed[r + 1] - speed[r]))


@kernel
def receive(
    received: Values,
    offset_um: Floats,
    smear_um: Floats,
    strength: Floats,
    vignette: Values,
    place: NDArray[np.int32],
    down: Values,
    right: Values,
    sigma_um: float,
    bells: Floats,
    errors: Floats,
) -> None:
    """Write the light of a uniform plane by one channel: a Gaussian line over the smear, clipped by the rim.

    Parameters
    ----------
    received : numpy.ndarray
        (cores,) output.
    offset_um, smear_um : numpy.ndarray
        From :func:`place_line`.
    strength : numpy.ndarray
        (cores,) grey levels for a Gaussian of 1 per um.
    vignette : numpy.ndarray
        (points, points) clipped over unclipped light.
    place, down, right : numpy.ndarray
        (cores,) index of the grid point above and to the left of each core, and how far the core is from it, in steps.
    sigma_um : float
        Standard deviation of the line, as it is collected.
    bells, errors : numpy.ndarray
        Tables of :mod:`napari_elsplus.simulation.model.bells`.
    """
    points = vignette.shape[1]
    clipped = vignette.reshape(-1)
    per_um = 1 / sigma_um
    height = 1 / (np.sqrt(2 * np.pi) * sigma_um)
    for n in range(len(received)):
        offset, smear = offset_um[n], smear_um[n]
        if not abs(offset) - smear / 2 < REACH * sigma_um:
            received[n] = 0
            continue
        if smear > NARROW_SLIT * sigma_um:
            to_error = per_um / np.sqrt(2.0)
            upper = error_function(errors, (offset + smear / 2) * to_error)
            light = (upper - error_function(errors, (offset - smear / 2) * to_error)) / (2 * smear)
        else:
            away = offset * per_um
            light = bell(bells, away) * height * (1 + (smear * per_um) ** 2 * (away * away - 1) / 24)
        p, x, y = np.uint64(place[n]), right[n], down[n]
        q = p + np.uint64(points)
        above = clipped[p] + x * (clipped[p + np.uint64(1)] - clipped[p])
        below = clipped[q] + x * (clipped[q + np.uint64(1)] - clipped[q])
        received[n] = strength[n] * light * (above + y * (below - above))


@kernel
def weigh(
    scale: Values,
    shift_um: Values,
    received: Values,
    parts: NDArray[np.int64],
    pulls: Floats,
    brightness: float,
    offset_um: Floats,
    negligible: float,
) -> None:
    """Write scale and row shift of a blurred image through some channels.

    Parameters
    ----------
    scale, shift_um : numpy.ndarray
        (cores,) output: fields of `CoreLight`.
    received : numpy.ndarray
        (channels, cores) light of a uniform plane by each channel.
    parts, pulls : numpy.ndarray
        (parts,) the channels, and by what part of the line's offset each displaces the image.
    brightness : float
        Of the plane.
    offset_um : numpy.ndarray
        From :func:`place_line`.
    negligible : float
        Light up to which no shift is computed.
    """
    for n in range(len(scale)):
        total, pulled = 0.0, 0.0
        for k in range(len(parts)):
            total += received[parts[k], n]
            pulled += pulls[k] * received[parts[k], n]
        scale[n] = brightness * total
        shift_um[n] = offset_um[n] * pulled / total if total > negligible else 0.0
