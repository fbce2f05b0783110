"""Dependence of the sectioning on the slit offset: saturation of the drop-offs, contrast to noise of ELS+.

Drop-off distances grow with the offset towards a limit (Thrapp and Hughes, Sec. 3.1): a small offset sections better,
but leaves less contrast over the noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import curve_fit

from napari_elsplus.errors import MeasurementError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray


def contrast_to_noise(ls: ArrayLike, residual: ArrayLike, read_noise: float) -> NDArray[np.float64]:
    """Return the contrast-to-noise ratio of ELS+ for shot-noise limited views.

    Parameters
    ----------
    ls, residual : array_like
        Electrons of the in-focus plane in each view.
    read_noise : float
        Read noise of both views together, electrons rms.
    """
    confocal, offset = np.asarray(ls, np.float64), np.asarray(residual, np.float64)
    return np.asarray((confocal - offset) / np.sqrt(confocal + offset + read_noise**2))


@dataclass(frozen=True, slots=True)
class SaturationFit:
    """Parameters of the paper's fit ``limit (1 - exp(-rate offset))`` of drop-offs against slit offset."""

    limit_um: float
    rate_per_um: float


def fit_saturation(offsets_um: ArrayLike, drops_um: ArrayLike) -> SaturationFit:
    """Fit the paper's saturation curve to drop-off distances against slit offset.

    Parameters
    ----------
    offsets_um, drops_um : array_like
        (m,) slit offsets and drop-off distances, micrometres.

    Raises
    ------
    MeasurementError
        If the distances do not follow such a curve.

    Examples
    --------
    >>> offset = np.array([12.0, 29, 40, 58, 77])
    >>> fit = fit_saturation(offset, 58 * (1 - np.exp(-0.032 * offset)))
    >>> round(fit.limit_um, 3), round(fit.rate_per_um, 5)
    (58.0, 0.032)
    """
    offset, drop = np.asarray(offsets_um, np.float64), np.asarray(drops_um, np.float64)
    start = (float(drop.max()), 1 / float(np.median(offset)))
    try:
        (limit, rate), _ = curve_fit(lambda x, a, b: a * (1 - np.exp(-b * x)), offset, drop, p0=start)
    except (RuntimeError, TypeError, ValueError) as error:
        raise MeasurementError(
            f"the drop-offs {drop} do not saturate ({error!s:.60})", "measure more offsets"
        ) from None
    return SaturationFit(float(limit), float(rate))
