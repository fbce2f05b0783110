"""Light on the cores while the laser line moves: computed where the scan changes, interpolated where the line jitters.

A jittering line is on other rows in every frame, and the light of each would take ten times as long as the rest of the
frame. As a function of the jitter it is smooth, since the line is wider than a row: in a scan that lasts, it is
interpolated linearly between jitters that are computed once.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from napari_elsplus.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from napari_elsplus.simulation.rendering.scan import CoreLight, LineScan
    from napari_elsplus.simulation.rendering.views import BundleView

    Rows = NDArray[np.float64]

SAME_LINE_ROWS: Final = 0.02
"""Difference of line positions, rows, below which the scan is not recomputed: no core changes by a grey level."""
JITTER_STEP_ROWS: Final = 0.25
"""From one computed jitter to the next; derived: a linear interpolation of the sharpest line of the presets (a standard
deviation of 1.75 rows) is then off by 0.3 % of its light at most."""
MAX_JITTER_ROWS: Final = 0.75
"""Standard deviation of a jitter that is interpolated, rows; derived: four of them to either side take 25 steps and, at
3 MB each, 80 MB; a wider one visits too many steps to be worth keeping them."""


COMPUTED_FRAMES: Final = 4
"""First frames of a scan, which are computed each for its own jitter; chosen: trial scans last for 1 to 3 frames, for
which two jitters to interpolate between would have to be computed in each."""


class ViewsLight(NamedTuple):
    """Light on the cores of both views, and for each term the smallest and the largest shift along the rows, um."""

    views: tuple[CoreLight, ...]
    shifts_um: tuple[tuple[float, float], ...]


class MixedLight(NamedTuple):
    """Light between two jitters of the line, at a share of the way from the first to the second."""

    first: ViewsLight
    second: ViewsLight
    share: float

    @property
    def shifts_um(self) -> Iterator[tuple[float, float]]:
        """Smallest and largest shift along the rows of each term, um."""
        for one, other in zip(self.first.shifts_um, self.second.shifts_um, strict=True):
            yield min(one[0], other[0]), max(one[1], other[1])


class LineIllumination:
    """Light on the cores of both views by the positions of the line.

    Parameters
    ----------
    scan : LineScan
        Computes it.
    views : sequence of BundleView
        Confocal and residual view.
    rows : int
        Rows of a frame.
    jitter_rows : float
        Standard deviation of the line's jitter.
    """

    def __init__(self, scan: LineScan, views: list[BundleView], rows: int, jitter_rows: float) -> None:
        self._scan, self._views = scan, views
        self._ideal = np.arange(rows, dtype=np.float64)
        self._interpolates = 0 < jitter_rows <= MAX_JITTER_ROWS
        self._line_rows: Rows | None = None
        self._steps: dict[int, ViewsLight] = {}
        self._frames = 0

    def at(self, line_rows: Rows | None, jitter_rows: float) -> MixedLight:
        """Return the light of a frame.

        Parameters
        ----------
        line_rows : numpy.ndarray or None
            (rows,) line positions without jitter; None is the ideal scan.
        jitter_rows : float
            Rows by which the line is lower in this frame.

        Raises
        ------
        InputError
            If there is not one position for each row.
        """
        if line_rows is not None and line_rows.shape != self._ideal.shape:
            problem = f"line positions of shape {line_rows.shape}"
            raise InputError(problem, f"give one for each of {len(self._ideal)} rows")
        self._follow(line_rows)
        if not jitter_rows:
            light = self._computed(0)
            return MixedLight(light, light, 0.0)
        self._frames += 1
        if not self._interpolates or self._frames <= COMPUTED_FRAMES:
            light = self._light(jitter_rows)
            return MixedLight(light, light, 0.0)
        below = int(np.floor(jitter_rows / JITTER_STEP_ROWS))
        share = jitter_rows / JITTER_STEP_ROWS - below
        return MixedLight(self._computed(below), self._computed(below + 1), share)

    def _follow(self, line_rows: Rows | None) -> None:
        """Discard what was computed if the line positions differ from those before."""
        if line_rows is not None and _same(line_rows, self._ideal):
            line_rows = None
        before = self._line_rows
        same = line_rows is before if line_rows is None or before is None else _same(line_rows, before)
        if not same:
            self._steps.clear()
            self._frames = 0
            self._line_rows = None if line_rows is None else line_rows.copy()

    def _computed(self, step: int) -> ViewsLight:
        if step not in self._steps:
            self._steps[step] = self._light(step * JITTER_STEP_ROWS)
        return self._steps[step]

    def _light(self, jitter_rows: float) -> ViewsLight:
        views = tuple(self._scan.light(view, self._line_rows, jitter_rows) for view in self._views)
        shifts_um = np.stack([light.shift_um for light in views])
        bounds = zip(shifts_um.min((0, 2)).tolist(), shifts_um.max((0, 2)).tolist(), strict=True)
        return ViewsLight(views, tuple(bounds))


def _same(a: Rows, b: Rows) -> bool:
    return np.array_equal(a, b) or bool(np.allclose(a, b, rtol=0, atol=SAME_LINE_ROWS, equal_nan=True))
