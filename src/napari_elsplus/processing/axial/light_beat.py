"""Beat of the light with the frame rate in a scan of depths: a harmonic of the frames' times that no depth explains.

A lamp or laser that flickers near a multiple of the frame rate seems to beat slowly, which bends the curves of LS and
ELS+ alike. LS decreases smoothly with depth; what varies about that periodically in time is the light. A beat whose
phase advances with the depth as slowly as the curve itself, over most of a scan in one direction, is not told from it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Curve = NDArray[np.float64]

_SIGNALS: Final = 0.05, 0.9
"""Of the largest signal, between which frames beyond it are used; chosen: of dimmer ones the error of the background
counts more, and brighter ones may be those of a plate that is pressed, whose curve has a kink."""
_DEGREE: Final = 7
"""Of the polynomial of LS; measured: with 6 some of 180 scans of a plain model in steady light show a beat, with 7
none; the lower, the slower the beats that are told from it."""
_MIN_LEFT: Final = 0.1
"""Power of a harmonic that polynomial and fading leave, of which it is measured; chosen: the noise counts thrice."""
_MIN_PERIOD_FRAMES: Final = 4
"""Chosen: shorter beats are noise from frame to frame, which is estimated as such."""
_OVERSAMPLING: Final = 4
"""Periods that are tried, over those that differ by one in the scan; chosen: the peak is missed by 5 %."""
_MIN_NOISE: Final = 5e-4
"""Of a frame's light; chosen: hardly any is steadier, and the polynomial is off by less."""
_MIN_LOG_ODDS: Final = 5.0
"""Of a beat over noise beyond that of the trials, nats; chosen: noise exceeds it in one of 10,000 scans."""


class LightBeat(NamedTuple):
    """Beat of the light in a scan.

    Parameters
    ----------
    share : float
        Amplitude, of the mean light.
    period_frames : float
        Frames from one maximum to the next.
    gains : numpy.ndarray
        (T,) factors that make up for it.
    errors : numpy.ndarray
        (3, T) factors by which these err, one standard deviation each: of amplitude, phase and period.
    slower : bool
        True if a slower beat, which is not told from the response, would explain the frames as well.
    """

    share: float
    period_frames: float
    gains: Curve
    errors: Curve
    slower: bool = False


def light_beat(depths_um: Curve, ls: Curve) -> LightBeat | None:
    """Return the beat of the light in a scan; None where frames do not show one.

    Parameters
    ----------
    depths_um : numpy.ndarray
        (T,) depth of each frame, in the order of recording.
    ls : numpy.ndarray
        (T,) confocal signal in grey levels, without its background.

    Examples
    --------
    >>> depths = np.linspace(0.0, 400, 100)
    >>> steady, noise = 1 / (1 + depths / 60), 1 + np.random.default_rng(0).normal(0, 0.001, 100)
    >>> beat = light_beat(depths, steady * noise * (1 + 0.03 * np.sin(np.arange(100) / 2)))
    >>> round(beat.share, 3), round(beat.period_frames, 1), light_beat(depths, steady * noise)
    (0.03, 12.6, None)
    """
    least, most = (share * ls.max() for share in _SIGNALS)
    used = (ls > least) & (ls < most) & (depths_um > depths_um[np.argmax(ls)])
    bright, time = np.flatnonzero(used), np.arange(len(ls), dtype=np.float64)
    freedom = len(bright) - _DEGREE - 5
    if freedom < _DEGREE:
        return None
    away_um = depths_um[bright] - depths_um[bright].min()
    place = np.log1p(away_um / max(float(away_um[np.argmin(np.abs(ls[bright] - ls.max() / 2))]), 1.0))
    falling = np.polynomial.legendre.legvander(2 * place / max(place.max(), 1.0) - 1, _DEGREE)
    smooth = np.linalg.svd(np.c_[falling, time[bright]], full_matrices=False)[0]
    level = np.log(ls[bright])
    level -= smooth @ (smooth.T @ level)
    best_gain, slower_gain, best = 0.0, 0.0, None
    for cycles in np.arange(1, _OVERSAMPLING * len(ls) // _MIN_PERIOD_FRAMES) / _OVERSAMPLING:
        turn = 2 * np.pi * cycles / len(ls) * time
        harmonic = np.stack([np.cos(turn), np.sin(turn)], axis=1)
        factors, curvature, gain = _fit(harmonic[bright], level, smooth)
        if np.linalg.eigvalsh(curvature)[0] <= _MIN_LEFT * len(bright) / 2:
            slower_gain = max(gain, slower_gain)
        elif gain > best_gain:
            turning = turn * (harmonic @ (factors[1], -factors[0]))  # by a small change of the period
            best_gain, best = gain, (cycles, np.c_[harmonic, turning])
    if best is None:
        return None
    cycles, terms = best
    factors, curvature, gain = _fit(terms[bright], level, smooth)
    variance = max((float(level @ level) - gain) / freedom, _MIN_NOISE**2)
    if best_gain / (2 * variance) < _MIN_LOG_ODDS + 2 * np.log(len(bright)):
        return None
    values, axes = np.linalg.eigh(curvature)
    errors = np.exp(np.clip(terms @ axes * np.sqrt(variance / np.maximum(values, 1e-9)), -1, 1)).T
    slower = (best_gain - slower_gain) / (2 * variance) < _MIN_LOG_ODDS
    return LightBeat(float(np.hypot(*factors[:2])), float(len(ls) / cycles), np.exp(-terms @ factors), errors, slower)


def _fit(terms: Curve, level: Curve, smooth: Curve) -> tuple[Curve, Curve, float]:
    """Return the factors of terms (frames, n) beside a smooth curve, their curvature, and the square they explain."""
    left = terms - smooth @ (smooth.T @ terms)
    curvature = left.T @ left
    factors: Curve = np.asarray(np.linalg.pinv(curvature) @ (left.T @ level), np.float64)
    return factors, curvature, float(level @ left @ factors)
