"""Resolution by the paper's measure: the finest element of a bar target whose bars are resolved.

A line pair is a bar and a gap; the paper's 5.52 um and 8.8 um are such periods (USAF 1951, group 7 element 4 and group
6 element 6), not widths of a point spread function. Thrapp and Hughes, Methods.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from napari_elsplus.errors import InputError, MeasurementError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

RESOLVED_CONTRAST: Final = 0.1
"""Smallest Michelson contrast of a resolved element; chosen: a usual limit of visibility (the paper states none)."""


@dataclass(frozen=True, slots=True)
class BarElement:
    """Parallel bars of one element of a target, located in an image.

    Parameters
    ----------
    line_pair_um : float
        Period, a bar and a gap, micrometres.
    bars_px : tuple
        Edges (top, left, bottom, right) of each bar in pixels, in order across the element; at least two.
    """

    line_pair_um: float
    bars_px: tuple[tuple[float, float, float, float], ...]


def element_contrast(image: NDArray[np.floating], element: BarElement) -> float:
    """Return the Michelson contrast between the bars of an element and the gaps between them.

    Parameters
    ----------
    image : numpy.ndarray
        (rows, cols), bars brighter than gaps.
    element : BarElement
        Location of its bars.

    Returns
    -------
    float
        (bars - gaps) / (bars + gaps) of the mean grey levels in the middle half of each bar and gap; negative where
        the gaps are brighter, NaN if both are dark.

    Raises
    ------
    InputError
        If the element lies outside of the image.

    Examples
    --------
    >>> image = np.zeros((6, 10))
    >>> image[:, [0, 1, 4, 5, 8, 9]] = 3.0
    >>> image[:, [2, 3, 6, 7]] = 1.0
    >>> element_contrast(image, BarElement(4.0, ((0, 0, 6, 2), (0, 4, 6, 6), (0, 8, 6, 10))))
    0.5
    """
    bars = element.bars_px
    if len(bars) < 2:
        raise InputError(f"an element of {len(bars)} bars", "give at least two")
    gaps = [_between(first, second) for first, second in pairwise(bars)]
    bright = float(np.mean([_middle_level(image, bar) for bar in bars]))
    dark = float(np.mean([_middle_level(image, gap) for gap in gaps]))
    total = bright + dark
    return (bright - dark) / total if total > 0 else float("nan")


def smallest_resolved_line_pair_um(image: NDArray[np.floating], elements: Iterable[BarElement]) -> float:
    """Return the finest period of a bar target down to which every element has a contrast of `RESOLVED_CONTRAST`.

    Parameters
    ----------
    image : numpy.ndarray
        (rows, cols).
    elements : iterable of BarElement
        Of any periods and orientations; several may share a period.

    Returns
    -------
    float
        Micrometres per line pair.

    Raises
    ------
    InputError
        If there are no elements, or one lies outside of the image.
    MeasurementError
        If not even the coarsest element is resolved.
    """
    periods: dict[float, list[BarElement]] = {}
    for element in elements:
        periods.setdefault(element.line_pair_um, []).append(element)
    if not periods:
        raise InputError("a target of 0 elements", "give the positions of its elements")
    finest = None
    for period_um in sorted(periods, reverse=True):
        if not all(element_contrast(image, element) >= RESOLVED_CONTRAST for element in periods[period_um]):
            break
        finest = period_um
    if finest is None:
        raise MeasurementError(
            f"no element of the target is resolved (contrast below {RESOLVED_CONTRAST:g} at {max(periods):.1f} um)",
            "is the target in focus, and at the given position?",
        )
    return finest


def bars_within(box_px: tuple[float, float, float, float], period_um: float, *, upright: bool) -> BarElement:
    """Return the element of three bars and two gaps that fill a box.

    Parameters
    ----------
    box_px : tuple of float
        Edges (top, left, bottom, right), drawn closely around the three bars.
    period_um : float
        Period, a bar and a gap, micrometres.
    upright : bool
        True if the bars run along the columns.

    Examples
    --------
    >>> bars_within((0, 10, 5, 15), 8.0, upright=True).bars_px
    ((0, 10.0, 5, 11.0), (0, 12.0, 5, 13.0), (0, 14.0, 5, 15.0))
    """
    top, left, bottom, right = box_px
    low, high = (left, right) if upright else (top, bottom)
    step = (high - low) / 5
    edges = [(low + 2 * k * step, low + (2 * k + 1) * step) for k in range(3)]
    bars = ((top, start, bottom, end) if upright else (start, left, end, right) for start, end in edges)
    return BarElement(period_um, tuple(bars))


def nearest_usaf_1951(line_pair_um: float) -> tuple[int, int, float]:
    """Return group, element and period (um) of the USAF 1951 element nearest to a line pair of `line_pair_um`.

    Examples
    --------
    >>> group, element, period_um = nearest_usaf_1951(5.4)
    >>> group, element, round(period_um, 2)
    (7, 4, 5.52)
    """
    sixths = round(6 * np.log2(1000 / line_pair_um))
    group, step = divmod(sixths, 6)
    return group, step + 1, 1000 * 2 ** (-sixths / 6)


def _between(
    first: tuple[float, float, float, float], second: tuple[float, float, float, float]
) -> tuple[float, float, float, float]:
    if second[0] >= first[2]:
        return first[2], max(first[1], second[1]), second[0], min(first[3], second[3])
    return max(first[0], second[0]), first[3], min(first[2], second[2]), second[1]


def _middle_level(image: NDArray[np.floating], box: tuple[float, float, float, float]) -> float:
    """Return the mean over the middle half of a box across its short side, and three quarters along its long one."""
    spans = [(box[0], box[2]), (box[1], box[3])]
    short = int(spans[1][1] - spans[1][0] < spans[0][1] - spans[0][0])
    cells = []
    for axis, (low, high) in enumerate(spans):
        kept = 0.5 if axis == short else 0.75
        middle, half = (low + high) / 2, kept * (high - low) / 2
        first = int(np.floor(middle - half + 0.5))
        last = max(int(np.floor(middle + half + 0.5)), first + 1)
        if first < 0 or last > image.shape[axis]:
            raise InputError(
                f"a bar from {low:.0f} to {high:.0f} px lies outside of the image of {image.shape[axis]} px",
                "give the position of the target",
            )
        cells.append(slice(first, last))
    return float(image[cells[0], cells[1]].mean())
