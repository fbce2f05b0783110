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
"""Power of a harmonic that polynomial and fading leave, below which it is not told from the response; chosen."""
_USUAL_SHARE: Final = 0.03
"""Standard deviation of a harmonic's amplitudes over the mean light; chosen: larger beats are seen by eye."""
_MIN_PERIOD_FRAMES: Final = 4
"""Chosen: shorter beats are noise from frame to frame, which is estimated as such."""
_OVERSAMPLING: Final = 4
"""Periods that are tried, over those that differ by one in the scan; chosen: those between are within a linear step."""
_MIN_NOISE: Final = 5e-4
"""Of a frame's light; chosen: hardly any is steadier, and the polynomial is off by less."""
_MIN_LOG_ODDS: Final = 5.0
"""Of a beat of any period over steady light, nats; measured: none of 480 scans of a plain model in steady light reaches
3."""
_MOSTLY_ONCE: Final = 0.75
"""Depths over frames, above which a scan goes one way; chosen: one there and back has half as many."""
_MIN_PROBABILITY: Final = 0.01
"""Of a beat that is not told from the response, at which a warning names it; chosen."""
_MIN_ERROR: Final = 0.05
"""Of the largest error, below which others are left out; chosen: their squares add a quarter of a per cent."""


class LightBeat(NamedTuple):
    """Beat of the light in a scan.

    Parameters
    ----------
    share : float
        Amplitude of the most probable beat, of the mean light.
    period_frames : float
        Frames from one of its maxima to the next.
    gains : numpy.ndarray
        (T,) factors that make up for the light, the mean over all periods by their probabilities.
    errors : numpy.ndarray
        (n, T) factors by which these err, one standard deviation each: by amplitude, phase and period.
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
    cycles = np.arange(1, _OVERSAMPLING * len(ls) // _MIN_PERIOD_FRAMES) / _OVERSAMPLING
    harmonics = [_harmonic(2 * np.pi * each / len(ls) * time, bright, smooth) for each in cycles]
    explained = max(float(level @ left @ np.linalg.pinv(left.T @ left) @ (left.T @ level)) for _, left in harmonics)
    variance = max((float(level @ level) - explained) / freedom, _MIN_NOISE**2)
    beats = [
        _fit(each, time, bright, smooth, level, variance, harmonic)
        for each, harmonic in zip(cycles / len(ls), harmonics, strict=True)
    ]
    evidence = np.array([beat.log_odds for beat in beats])
    untold = np.array([np.linalg.eigvalsh(left.T @ left)[0] <= _MIN_LEFT * len(bright) / 2 for _, left in harmonics])
    if len(np.unique(depths_um[bright])) < _MOSTLY_ONCE * len(bright):
        evidence[untold] = -np.inf  # frames of one depth show slow light, which may be a displaced plate: `light_loss`
    if np.logaddexp.reduce(evidence) - np.log(len(beats)) < _MIN_LOG_ODDS:
        return None
    probability = np.exp(evidence - np.logaddexp.reduce(evidence))
    mean = probability @ np.array([beat.light for beat in beats])
    away = [
        np.sqrt(weight) * np.vstack([beat.light - mean, beat.errors])
        for weight, beat in zip(probability, beats, strict=True)
    ]
    _, sizes, modes = np.linalg.svd(np.concatenate(away), full_matrices=False)
    errors = (sizes[:, None] * modes)[sizes > _MIN_ERROR * sizes[0]]
    best = int(np.argmax(probability))
    return LightBeat(
        share=beats[best].share,
        period_frames=float(len(ls) / cycles[best]),
        gains=np.asarray(np.exp(-mean), np.float64),
        errors=np.asarray(np.exp(np.clip(errors, -1, 1)), np.float64),
        slower=bool(probability[untold].sum() > _MIN_PROBABILITY),
    )


class _Beat(NamedTuple):
    """A beat of one period: log odds over steady light, amplitude, logarithm of its light (T,) and errors (3, T)."""

    log_odds: float
    share: float
    light: Curve
    errors: Curve


def _harmonic(turn: Curve, bright: NDArray[np.intp], smooth: Curve) -> tuple[Curve, Curve]:
    """Return the cosine and sine of all frames, (T, 2), and what the smooth curve leaves of those of bright ones."""
    terms = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    return terms, terms[bright] - smooth @ (smooth.T @ terms[bright])


def _fit(
    per_frame: float,
    time: Curve,
    bright: NDArray[np.intp],
    smooth: Curve,
    level: Curve,
    variance: float,
    harmonic: tuple[Curve, Curve],
) -> _Beat:
    """Fit a beat of so many cycles per frame to what a smooth curve leaves of the light, by Gaussian priors."""
    terms, left = harmonic
    factors = np.linalg.solve(left.T @ left + variance / _USUAL_SHARE**2 * np.eye(2), left.T @ level)
    turning = 2 * np.pi * per_frame * time * (terms @ (factors[1], -factors[0]))  # by a small change of the period
    terms = np.c_[terms, turning]
    left = np.c_[left, turning[bright] - smooth @ (smooth.T @ turning[bright])]
    step = 1 / (_OVERSAMPLING * np.sqrt(12) * per_frame * len(time))  # of periods between those that are tried
    usual = np.array([_USUAL_SHARE, _USUAL_SHARE, step])
    precision = left.T @ left / variance + np.diag(usual**-2)
    known = left.T @ level / variance
    factors = np.linalg.solve(precision, known)
    log_odds = float(known @ factors - np.linalg.slogdet(precision * np.outer(usual, usual))[1]) / 2
    errors = np.linalg.solve(np.linalg.cholesky(precision), terms.T)
    return _Beat(log_odds, float(np.hypot(*factors[:2])), np.asarray(terms @ factors, np.float64), errors)
