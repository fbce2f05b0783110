"""Axial response: decrease of a fluorescent plate's signal with its distance from the focus (the paper, Sec. 3.1).

The distances at which the mean of LS and of ELS+ has fallen to a half (3 dB) and to a tenth (10 dB) of its value in
contact measure the optical sectioning.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, hypot, log
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from napari_elsplus.errors import InputError, MeasurementError
from napari_elsplus.processing.axial.black_level import black_level
from napari_elsplus.processing.axial.bleaching import light_loss
from napari_elsplus.processing.axial.contact import find_contact
from napari_elsplus.processing.axial.curve_noise import MIN_POINTS, DepthMeans, means_at_depths, noise_of_curve
from napari_elsplus.processing.axial.falling_curve import DropOff as DropOff
from napari_elsplus.processing.axial.falling_curve import FallingCurve
from napari_elsplus.processing.axial.light_beat import light_beat
from napari_elsplus.processing.axial.tilt import Tilt, plate_tilt

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from napari_elsplus.processing.axial.black_level import BlackLevel, DarkLevels
    from napari_elsplus.processing.axial.bleaching import LightLoss
    from napari_elsplus.processing.axial.falling_curve import Rise
    from napari_elsplus.processing.axial.light_beat import LightBeat
    from napari_elsplus.processing.axial.tilt import SquareHalves

    Curve = NDArray[np.float64]

LEVEL_3DB: Final = 0.5
"""Level of the 3 dB drop-off, fraction of the signal in contact (the paper, Sec. 3.1)."""
LEVEL_10DB: Final = 0.1
"""Level of the 10 dB drop-off, fraction of the signal in contact (the paper, Sec. 3.1)."""
MAX_UNCERTAINTY: Final = 0.01
"""Standard deviation of an ELS+ distance over it, beyond which it is warned of; chosen: three of it are the 3 % by
which a rig may differ from another."""
MAX_CHANCE: Final = 0.005
"""Part of it that frames vary by, beyond which more are advised; derived: halo and bow of 100 random rigs move the
distances by up to 2.2 %, which leaves 0.8 % for it and for the gain."""
MAX_BLEACHED: Final = 0.9
"""Share of all that scans of a bleaching plate can ever show from which no further ones are advised; chosen: the rest
would lower the uncertainty by a twentieth."""
ASSUMED_LOSS: Final = 0.1
"""Light lost in a scan that shows none of it, whose effect is stated; chosen, a round number."""
MAX_LEVEL: Final = 0.2
"""Part of the ELS+ 3 dB distance over which signals may be level in contact; chosen: those behind a lens fall by less
than noise over about a tenth."""
_MIN_LIGHT: Final = 0.01
"""LS, share of that in contact, below which noise is not expected to fall further; chosen: the camera's own is left."""
_MIN_SIGNAL_SIGMAS: Final = 3
"""Smallest signal in contact, standard deviations of its noise; chosen: the usual limit of detection."""


@dataclass(frozen=True, slots=True)
class AxialResponse:
    """Axial response measured by a scan of depths.

    Parameters
    ----------
    depth_um : numpy.ndarray
        Depths (depths,) in increasing order, each once.
    contact_um : float
        Depth at which the plate is in contact, one of those recorded (`find_contact`).
    contact_uncertainty_um : float
        Its standard deviation by steps, noise and displacement, part of that of each distance; 0 where contact is the
        first depth, at which it is known, or else assumed.
    ls, residual, els : numpy.ndarray
        Normalised curves: LS and residual over LS in contact, ELS+ over ELS+ in contact.
    ls_3db, ls_10db, els_3db, els_10db : DropOff
        Distances from contact.
    signal_kept : float
        ELS+ over LS in contact.
    signal_kept_uncertainty : float
        Its standard deviation.
    loss : LightLoss, optional
        Light that was lost in the course of the scan, by bleaching; corrected where significant. None where too few
        depths were recorded more than once.
    unseen_um : float
        By how much the ELS+ 10 dB distance, else that of 3 dB, is too short if `ASSUMED_LOSS` of the light was lost in
        the course of a scan that does not show it; 0 of one that does.
    level_um : float
        Distance from the first depth over which the signals do not change, as those of a plate that is pressed do not.
    displaced_um : float
        By how much the plate's distance differs between frames of one depth, from the first frame to the last.
    tilt : Tilt, optional
        Of the plate; what the gap in the middle changes is part of the uncertainties. None where it is not measured.
    rise : Rise, optional
        Depths between which the signal rises again beyond contact, as that of a second plane; None where it does not.
    black : BlackLevel, optional
        Black level that was left in the signals, and subtracted. None where the pixels beside the views are not given.
    beat : LightBeat, optional
        Periodic variation of the light with the frames, which is corrected; None where there is none.
    """

    depth_um: Curve
    contact_um: float
    contact_uncertainty_um: float
    ls: Curve
    residual: Curve
    els: Curve
    ls_3db: DropOff
    ls_10db: DropOff
    els_3db: DropOff
    els_10db: DropOff
    signal_kept: float
    signal_kept_uncertainty: float
    loss: LightLoss | None = None
    unseen_um: float = 0.0
    level_um: float = 0.0
    displaced_um: float = 0.0
    tilt: Tilt | None = None
    rise: Rise | None = None
    black: BlackLevel | None = None
    beat: LightBeat | None = None

    @property
    def frames_advised(self) -> int:
        """Multiple of the frames by which the ELS+ distances are known to `MAX_CHANCE`, or as well as bleaching allows.

        Each further scan has the weight of the one before times the square of the light left.
        """
        wanted = (self.chance / MAX_CHANCE) ** 2
        left = 1.0 if self.loss is None else min(self.loss.after_scan**2, 1.0)
        if left == 1.0:
            return max(1, ceil(wanted))
        reached = min(wanted * (1 - left), MAX_BLEACHED)
        return max(1, ceil(log(1 - reached) / log(left)))

    @property
    def chance(self) -> float:
        """Largest part of an ELS+ distance by which it varies from scan to scan, one standard deviation."""
        return max(drop.random_um / drop.um for drop in self._els_drops)

    @property
    def uncertainty(self) -> float:
        """Largest standard deviation of an ELS+ distance over it."""
        return self.least_certain.uncertainty_um / self.least_certain.um

    @property
    def contact_assumed(self) -> bool:
        """True if the signal falls from the first depth on, which is not given as 0: contact may lie before it."""
        return bool(self.contact_um == self.depth_um[0] != 0)

    @property
    def gap_share(self) -> float:
        """Largest part of a distance that a gap in the middle of a tilted plate changes."""
        gap_um = 0.0 if self.tilt is None else self.tilt.gap_um
        drops = (self.ls_3db, self.ls_10db, self.els_3db, self.els_10db)
        return max((drop.per_gap * gap_um / drop.um for drop in drops if drop.um > 0), default=0.0)

    @property
    def pressed(self) -> bool:
        """True if the signals do not change over the first `MAX_LEVEL` of the ELS+ 3 dB distance."""
        return bool(self.level_um > MAX_LEVEL * self.els_3db.um)

    @property
    def least_certain(self) -> DropOff:
        """ELS+ distance of which its uncertainty is the largest part."""
        return max(self._els_drops, key=lambda drop: drop.uncertainty_um / drop.um)

    @property
    def _els_drops(self) -> list[DropOff]:
        drops = [drop for drop in (self.els_3db, self.els_10db) if np.isfinite(drop.um) and drop.um > 0]
        return drops or [DropOff(1.0, 0.0)]

    def content(self) -> dict[str, Any]:
        """Return all results, ready for JSON; a distance that the scan does not reach is None."""

        def number(value: float) -> float | None:
            return float(value) if np.isfinite(value) else None

        def drops(three: DropOff, ten: DropOff) -> dict[str, float | None]:
            return {
                "drop_3db_um": number(three.um),
                "drop_10db_um": number(ten.um),
                "drop_3db_uncertainty_um": number(three.uncertainty_um),
                "drop_10db_uncertainty_um": number(ten.uncertainty_um),
            }

        return {
            "ls": drops(self.ls_3db, self.ls_10db),
            "els": drops(self.els_3db, self.els_10db),
            "signal_kept": self.signal_kept,
            "signal_kept_uncertainty": self.signal_kept_uncertainty,
            "contact_um": self.contact_um,
            "contact_uncertainty_um": self.contact_uncertainty_um,
            "light_lost": None if self.loss is None else self.loss.share,
            "light_lost_uncertainty": None if self.loss is None else self.loss.share_uncertainty,
            "tilt_deg": None if self.tilt is None else self.tilt.degrees,
            "tilt_uncertainty_deg": None if self.tilt is None else self.tilt.uncertainty_deg,
            "black_level_subtracted_dn": 0.0 if self.black is None else self.black.dn,
            "depth_um": self.depth_um.tolist(),
            "profiles": {"ls": self.ls.tolist(), "residual": self.residual.tolist(), "els": self.els.tolist()},
        }


class SystematicUncertainty(NamedTuple):
    """Systematic uncertainties, common to all depths, which the scatter of the points does not contain.

    Parameters
    ----------
    ls_zero_dn, residual_zero_dn : float
        Standard deviations of the zero of LS and of the residual, grey levels.
    gain : float
        Relative standard deviation of the residual gain.
    """

    ls_zero_dn: float = 0.0
    residual_zero_dn: float = 0.0
    gain: float = 0.0

    def with_zero(self, ls_dn: float, residual_dn: float) -> SystematicUncertainty:
        """Return them with further uncertainties of both zeros (`ls_dn`, `residual_dn`), which are independent."""
        zeros = np.hypot([self.ls_zero_dn, self.residual_zero_dn], [ls_dn, residual_dn])
        return SystematicUncertainty(float(zeros[0]), float(zeros[1]), self.gain)


_NO_SYSTEMATIC = SystematicUncertainty()


def axial_response(
    depths_um: ArrayLike,
    ls: ArrayLike,
    residual: ArrayLike,
    systematic: SystematicUncertainty = _NO_SYSTEMATIC,
    dark: DarkLevels | None = None,
    halves: SquareHalves | None = None,
) -> AxialResponse:
    """Estimate drop-off distances and kept signal from signals against depth.

    Frames at the same depth are averaged. They also show what the plate has lost of its light in between, by bleaching,
    which is made up for where it is significant, each frame weighted by the square of the light left: record scans
    there and back. Beyond contact (`find_contact`), drop-offs are taken from an isotonic regression, so that noise does
    not end a curve too early.

    Parameters
    ----------
    depths_um : array_like
        Depth of each frame (T,) as recorded, in any order, not necessarily equidistant nor from zero.
    ls, residual : array_like
        Signals (T,) in grey levels, the background subtracted.
    systematic : SystematicUncertainty
        Uncertainties common to all depths; they add to those of the distances.
    dark : DarkLevels, optional
        Level of the pixels beside the views, by which a black level that is left in the signals is subtracted.
    halves : SquareHalves, optional
        Light of the measured square's halves, by which a tilt of the plate is known.

    Returns
    -------
    AxialResponse
        Distances that the scan does not reach are NaN.

    Raises
    ------
    InputError
        If the lengths differ, there are too few depths, or a number is not finite.
    MeasurementError
        If LS or ELS+ in contact does not stand out of its noise, or LS does not fall beyond contact.

    Examples
    --------
    >>> depth = np.arange(0.0, 800, 2)
    >>> ls, els = 1 / (1 + depth / 60), 1 / (1 + (depth / 30) ** 2)
    >>> response = axial_response(depth, ls, ls - els)
    >>> [round(drop.um) for drop in (response.ls_3db, response.ls_10db, response.els_3db, response.els_10db)]
    [60, 540, 30, 90]
    """
    depths, *signals = _checked(depths_um, ls, residual)
    black = None
    if dark is not None:
        black = black_level(dark, *signals)
        signals = [signals[0] - black.frames_dn, signals[1] - black.frames_dn / dark.residual_gain]
        systematic = systematic.with_zero(black.uncertainty_dn, black.uncertainty_dn / dark.residual_gain)
    if (beat := light_beat(depths, signals[0])) is not None:
        signals = [each * beat.gains for each in signals]
    loss = light_loss(depths, signals[0], signals[0] - signals[1])
    gains = np.ones(len(depths)) if loss is None else loss.gains()
    of_ls, of_residual, of_els = means = _means(depths, signals, gains)
    found = find_contact(of_ls, of_els)
    contact = found.place
    gain = float(np.average(gains, weights=gains**-2))
    zeros = gain * systematic.ls_zero_dn, gain * systematic.residual_zero_dn
    correlated_dn = systematic.gain * of_residual.mean[contact:]
    ls_fall, els_fall = _falls(means, contact, zeros, correlated_dn)
    _require_signal(of_ls, of_els, ls_fall, els_fall, float(correlated_dn[0]))
    if contact == len(of_ls.depth) - 1:
        raise MeasurementError(
            f"the plate's signal is largest at the last depth, {of_ls.depth[contact] + 0.0:g} um",
            "do the depths grow away from the probe, and are they in the order of the frames?",
        )
    kept = els_fall.contact / ls_fall.contact
    rate = -log(1 - ASSUMED_LOSS) / (len(depths) - 1) if loss is None else loss.error
    drops = _drops((ls_fall, els_fall))

    def changes(factor: Curve) -> list[float]:
        """Return by how much each distance changes if the gains differ by a factor (T,)."""
        others = _drops(_falls(_means(depths, signals, gains * factor), contact, zeros, correlated_dn))
        return [float(np.nan_to_num(other.um - drop.um)) for drop, other in zip(drops, others, strict=True)]

    by_fading = changes(np.exp(rate * np.arange(len(depths))))
    by_loss = () if loss is None else (by_fading, *map(changes, (loss.gains(1.0) / gains, *loss.slow_errors())))
    for each in (*by_loss, *map(changes, () if beat is None else beat.errors)):
        drops = [drop.with_systematic(um) for drop, um in zip(drops, each, strict=True)]
    tilt = None if halves is None else plate_tilt(depths, halves, ls_fall)
    if tilt is not None:
        drops = [drop.with_systematic(drop.per_gap * tilt.gap_um) for drop in drops]
    rise = els_fall.rise or ls_fall.rise
    if rise is not None:  # distances beyond it are not those of one plane
        before_um = rise.from_um - float(of_ls.depth[contact])
        drops = [drop.with_systematic(max(drop.um - before_um, 0.0)) for drop in drops]
    slope = ls_fall.first_slope or np.inf  # a signal that does not fall shows no displacement
    displaced_um = 0.0 if loss is None else loss.by_distance * (len(depths) - 1) / slope
    contact_uncertainty_um = hypot(found.uncertainty_um, displaced_um / 2)  # the mean of first and last frames
    drops = [drop.with_systematic(drop.per_contact * contact_uncertainty_um) for drop in drops]
    by_contact_dn = els_fall.contact * (els_fall.first_slope - ls_fall.first_slope) * contact_uncertainty_um
    return AxialResponse(
        depth_um=of_ls.depth,
        contact_um=float(of_ls.depth[contact]),
        contact_uncertainty_um=contact_uncertainty_um,
        level_um=found.level_um,
        displaced_um=displaced_um,
        tilt=tilt,
        rise=rise,
        ls=of_ls.mean / ls_fall.contact,
        residual=of_residual.mean / ls_fall.contact,
        els=of_els.mean / els_fall.contact,
        ls_3db=drops[0],
        ls_10db=drops[1],
        els_3db=drops[2],
        els_10db=drops[3],
        signal_kept=float(kept),
        signal_kept_uncertainty=float(
            np.linalg.norm([els_fall.noise, kept * ls_fall.noise, correlated_dn[0], by_contact_dn]) / ls_fall.contact
        ),
        loss=loss,
        unseen_um=0.0 if loss is not None else abs(by_fading[3] or by_fading[2]),
        black=black,
        beat=beat,
    )


def _require_signal(
    of_ls: DepthMeans, of_els: DepthMeans, ls_fall: FallingCurve, els_fall: FallingCurve, correlated_dn: float
) -> None:
    """Raise a MeasurementError if LS or ELS+ in contact does not stand out of its noise."""
    if not (ls_fall.contact > _MIN_SIGNAL_SIGMAS * ls_fall.noise and ls_fall.contact > 0):
        raise MeasurementError(
            f"the plate's signal in contact is {ls_fall.contact:.3g} grey levels, the noise {ls_fall.noise:.2g}",
            "is the laser on, and does the background belong to this scan?",
        )
    # In contact both views have the shot noise of LS, of which little is left at most depths.
    light = np.sqrt(np.maximum(of_ls.mean / ls_fall.contact, _MIN_LIGHT))
    els_noise = float(np.hypot(noise_of_curve(of_els.depth, of_els.mean / light)[0], correlated_dn))
    if not (els_fall.contact > _MIN_SIGNAL_SIGMAS * els_noise and els_fall.contact > 0):
        problem = f"ELS+ in contact is {els_fall.contact:.3g} grey levels, its uncertainty {els_noise:.2g}"
        raise MeasurementError(problem, "is the residual's slit off the line?")


def _means(depths: Curve, signals: list[Curve], gains: Curve) -> tuple[DepthMeans, DepthMeans, DepthMeans]:
    """Return the means of LS, residual and ELS+ at each depth, each frame made up for its lost light by a gain."""
    # Noise that does not grow with the light is raised by the gain: without weights, later scans would harm.
    ls, residual, weight = signals[0] * gains, signals[1] * gains, gains**-2
    of_ls, of_residual, of_els = (means_at_depths(depths, each, weight) for each in (ls, residual, ls - residual))
    return of_ls, of_residual, of_els


def _falls(
    means: tuple[DepthMeans, DepthMeans, DepthMeans],
    contact: int,
    zeros_dn: tuple[float, float],
    correlated_dn: Curve,
) -> tuple[FallingCurve, FallingCurve]:
    """Return the curves of LS and of ELS+ from contact on."""
    of_ls, _, of_els = (each.beyond(contact) for each in means)
    ls_fall = FallingCurve(of_ls, zeros_dn[0], np.zeros_like(correlated_dn))
    return ls_fall, FallingCurve(of_els, float(np.hypot(*zeros_dn)), correlated_dn)


def _drops(falls: tuple[FallingCurve, FallingCurve]) -> list[DropOff]:
    """Return the distances of LS at 3 and 10 dB, and those of ELS+."""
    return [fall.drop(level) for fall in falls for level in (LEVEL_3DB, LEVEL_10DB)]


def _checked(depths_um: ArrayLike, ls: ArrayLike, residual: ArrayLike) -> tuple[Curve, Curve, Curve]:
    depth, *signals = (np.asarray(values, np.float64) for values in (depths_um, ls, residual))
    if depth.ndim != 1 or any(signal.shape != depth.shape for signal in signals):
        problem = f"{depth.size} depths for {signals[0].size} frames"
        raise InputError(problem, "the scan has a depth for each frame: give one per line")
    if not all(np.isfinite(values).all() for values in (depth, *signals)):
        raise InputError("a depth or signal is NaN or infinite", "leave that frame out")
    if (different := len(np.unique(depth))) < MIN_POINTS:
        raise InputError(f"the scan has {different} different depths", f"give at least {MIN_POINTS}")
    return depth, signals[0], signals[1]
