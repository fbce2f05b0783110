"""Axial response in closed form: confocal, residual and ELS+ signal of a thin fluorescent plane at a distance.

Across the laser line the light at the bundle's face is a core and a halo (cross-talk and leaky modes of the bundle).
Out of focus it spreads as a Gaussian whose width grows linearly, split equally between excitation and collection. The
signal is the mean of the spread line over the slit: error functions.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
import scipy
from scipy.special import erf

from napari_elsplus.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Curve = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class LineModel:
    """The laser line at the bundle's face and its spread in depth.

    Parameters
    ----------
    core_um : float
        Standard deviation s0 of the line's core.
    halo_share : float
        Share c of the light that travels in the halo.
    halo_um : float
        Standard deviation s1 of the halo.
    spread : float
        Two-way spread k: micrometres of standard deviation per micrometre of depth.
    gap_um : float
        Gap z0 between a stained plate and the probe's face when they touch (tilt of the plate); the plate's only.

    Raises
    ------
    InputError
        If a number is impossible.
    """

    core_um: float
    halo_share: float
    halo_um: float
    spread: float
    gap_um: float

    def __post_init__(self) -> None:
        for name in ("core_um", "halo_um", "spread"):
            value = getattr(self, name)
            if not (isfinite(value) and value > 0):
                raise InputError(f"{name} of the line is {value}", "it must be a positive number")
        if not 0 <= self.halo_share <= 1:
            raise InputError(f"halo_share of the line is {self.halo_share}", "it must lie between 0 and 1")
        if not self.halo_um > self.core_um:
            raise InputError(f"the halo ({self.halo_um} um) is narrower than its line ({self.core_um} um)", "widen it")

    @property
    def parts(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Share and standard deviation (um) of core and halo."""
        return (1 - self.halo_share, self.core_um), (self.halo_share, self.halo_um)


NARROW_SLIT: Final = 0.2
"""Slit width over the standard deviation of a Gaussian up to which its second derivative suffices; derived: the fourth
adds 3e-6 of its maximum."""
FAR_UM: Final = 1e6
"""Depth within which drop-offs are sought, um; chosen, far beyond that of any line model."""
LINE_MODELS: Final = {
    "a": LineModel(core_um=5.58, halo_share=0.652, halo_um=38.3, spread=0.235, gap_um=14.3),
    "b": LineModel(core_um=2.34, halo_share=0.17, halo_um=33.8, spread=0.224, gap_um=20.2),
}
"""``a``: fitted to panels (a, b) of the paper's drop-off figure (Thrapp and Hughes, Sec. 3.1), with the rim of the
bundle (:mod:`benchmarks.studies.line_fit`). ``b``: the sharper line of its panels (c, d), which were measured in
another state of the rig; the two are never mixed."""


def gaussian_over_slit(offset_um: ArrayLike, slit_um: ArrayLike, sigma_um: ArrayLike) -> Curve:
    """Return the mean of a unit-area Gaussian over a slit, per micrometre.

    Parameters
    ----------
    offset_um, slit_um, sigma_um : array_like
        Distance of the slit's middle from the Gaussian's, the slit's width (0: a point), the standard deviation.

    Examples
    --------
    >>> print(round(float(gaussian_over_slit(0.0, 0.0, 1.0)), 4), round(float(gaussian_over_slit(0.0, 2.0, 1.0)), 4))
    0.3989 0.3413
    """
    offset, slit, sigma = np.broadcast_arrays(*(np.asarray(a, np.float64) for a in (offset_um, slit_um, sigma_um)))
    wide = slit > NARROW_SLIT * sigma
    mean = np.empty(offset.shape)
    if not wide.all():
        squared = np.square(offset / sigma)
        bent = 1 + np.square(slit / sigma) * (squared - 1) / 24  # by its second derivative
        mean[...] = np.exp(-0.5 * squared) / (np.sqrt(2 * np.pi) * sigma) * bent
    if wide.any():
        upper, lower = (np.asarray((offset + side * slit / 2)[wide] / (np.sqrt(2) * sigma[wide])) for side in (1, -1))
        mean[wide] = 0.5 * (erf(upper) - erf(lower)) / slit[wide]
    return mean


def line_response(depth_um: ArrayLike, offset_um: ArrayLike, slit_um: ArrayLike, line: LineModel) -> Curve:
    """Return the signal of a uniform thin plane, per micrometre of slit, for a line at an offset from the slit.

    Parameters
    ----------
    depth_um : array_like
        Distance of the plane from the probe's face (a plate's gap is not added here).
    offset_um : array_like
        Distance of the line from the middle of the slit.
    slit_um : array_like
        Slit width, um.
    line : LineModel
        Model of the laser line.

    Returns
    -------
    numpy.ndarray
        Of the broadcast shape.
    """
    spread = line.spread * np.asarray(depth_um, np.float64)
    return np.asarray(
        sum(share * gaussian_over_slit(offset_um, slit_um, np.hypot(sigma, spread)) for share, sigma in line.parts)
    )


class ModelResponse(NamedTuple):
    """Signals of one plane, all on the scale on which the confocal signal in contact is 1."""

    ls: Curve
    residual: Curve
    els: Curve


def model_response(
    depth_um: ArrayLike, *, offset_um: ArrayLike, slit_um: ArrayLike = 2.9, line: LineModel = LINE_MODELS["a"]
) -> ModelResponse:
    """Return confocal, residual and ELS+ signal of a stained plate against its distance.

    Parameters
    ----------
    depth_um : array_like
        Distance of the plate from where it touches.
    offset_um : array_like
        Slit offset of the residual view; its sign does not matter here.
    slit_um : array_like
        Slit width.
    line : LineModel
        The line; its gap is added to the depth.

    Returns
    -------
    ModelResponse
        Arrays of the broadcast shape; confocal in contact is 1.

    References
    ----------
    .. [1] A. D. Thrapp and M. R. Hughes, "Reduced motion artifacts and speed improvements in enhanced line-scanning
       fiber bundle endomicroscopy", J. Biomed. Opt. (2021), "Optical Sectioning and Signal Drop".

    Examples
    --------
    >>> response = model_response([0.0, 119.9], offset_um=29.0)
    >>> (response.els / response.els[0]).round(2)
    array([1. , 0.1])
    """
    depth = np.asarray(depth_um, np.float64) + line.gap_um
    in_contact = line_response(line.gap_um, 0.0, slit_um, line)
    ls = line_response(depth, 0.0, slit_um, line) / in_contact
    residual = line_response(depth, offset_um, slit_um, line) / in_contact
    ls, residual = np.broadcast_arrays(ls, residual)
    return ModelResponse(ls, residual, ls - residual)


class ModelDropOffs(NamedTuple):
    """Distances at which a plate's signal has fallen to a half and to a tenth."""

    drop_3db_um: float
    drop_10db_um: float


def model_drop_offs(
    *, offset_um: float | None, slit_um: float = 2.9, line: LineModel = LINE_MODELS["a"]
) -> ModelDropOffs:
    """Solve the model for the 3 dB and 10 dB drop-off distances of ELS+, or of LS where no offset is given.

    The rim of the bundle is neglected, which reduces the LS 10 dB distance of a bundle of 620 um by 5 %.

    Parameters
    ----------
    offset_um : float or None
        Slit offset at the bundle; None for LS.
    slit_um : float
        Slit width at the bundle.
    line : LineModel
        Model of the laser line.

    Raises
    ------
    InputError
        If the offset is 0: then ELS+ has no signal.

    Examples
    --------
    >>> [round(um, 1) for um in model_drop_offs(offset_um=None)]
    [58.1, 579.8]
    >>> [round(um, 1) for um in model_drop_offs(offset_um=29.0)]
    [35.0, 119.9]
    """
    if offset_um == 0:
        raise InputError("the offset is 0 um, so ELS+ is zero everywhere", "offset the residual slit")

    def signal(depth_um: float) -> float:
        response = model_response(depth_um, offset_um=offset_um or 0.0, slit_um=slit_um, line=line)
        return float(response.ls if offset_um is None else response.els)

    contact = signal(0.0)
    root = scipy.optimize.brentq
    return ModelDropOffs(*(float(root(lambda z, f=f: signal(z) / contact - f, 0.0, FAR_UM)) for f in (0.5, 0.1)))


def signal_kept(*, offset_um: float, slit_um: float = 2.9, line: LineModel = LINE_MODELS["a"]) -> float:
    """Return the in-focus signal of ELS+ relative to LS, for a plate in contact.

    Parameters
    ----------
    offset_um : float
        Slit offset at the bundle.
    slit_um : float
        Slit width at the bundle.
    line : LineModel
        Model of the laser line.

    Examples
    --------
    >>> round(signal_kept(offset_um=29.0), 2), round(signal_kept(offset_um=77.0), 3)
    (0.82, 0.967)
    """
    return float(model_response(0.0, offset_um=offset_um, slit_um=slit_um, line=line).els)
