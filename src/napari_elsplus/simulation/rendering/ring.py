"""Frames made beforehand and played in a circle, for machines too busy to render as fast as the camera runs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from napari_elsplus.errors import InputError
from napari_elsplus.simulation.rendering.renderer import SAME_LINE_ROWS, Renderer

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Frame = NDArray[np.uint8]


class FrameLoop:
    """A fall-back for a renderer: the same calls, answered from memory.

    The ring holds the frames 0 to n - 1 for one instrument and one way in which the line moves; frame k is answered
    with frame k modulo n, so the probe jumps back where the circle closes unless its path does too. A line that moves
    otherwise invalidates it, and it renders until it is filled again. Slit, offset and region belong to the instrument:
    another instrument needs another renderer, and so another ring.

    Parameters
    ----------
    renderer : Renderer
        Whose frames to hold.
    frames : int
        How many: a quarter of a second at 240 Hz takes 60 frames or 42 MB.
    line_rows : numpy.ndarray, optional
        How the line moves; see :meth:`Renderer.render`.

    Raises
    ------
    InputError
        If there is no frame to hold.

    Examples
    --------
    >>> from napari_elsplus.simulation.model.instrument import Instrument
    >>> from napari_elsplus.simulation.specimen.scenes import scene
    >>> ring = FrameLoop(Renderer(Instrument.of("240hz"), scene("uniform")), frames=2)
    >>> bool((ring.render(5) == ring.renderer.render(1)).all()), ring.valid, ring.name
    (True, True, 'ring of 2 pre-rendered frames')
    """

    def __init__(self, renderer: Renderer, frames: int, line_rows: NDArray[np.float64] | None = None) -> None:
        if frames < 1:
            raise InputError(f"a ring of {frames} frames", "give at least 1")
        self.renderer = renderer
        self.frame_shape = renderer.frame_shape
        self._frames = np.empty((frames, *renderer.frame_shape), np.uint8)
        self.refill(line_rows)

    @property
    def name(self) -> str:
        """What a report calls it, so that nobody takes it for live rendering."""
        return f"ring of {len(self._frames)} pre-rendered frames"

    def refill(self, line_rows: NDArray[np.float64] | None = None) -> None:
        """Render the ring's frames for a line that moves so."""
        rows = np.arange(self.frame_shape[0], dtype=np.float64)
        self._line_rows = rows if line_rows is None else line_rows.copy()
        self.valid = True
        for index, frame in enumerate(self._frames):
            self.renderer.render(index, frame, line_rows=line_rows)

    def render(
        self, frame_index: int, out: Frame | None = None, *, line_rows: NDArray[np.float64] | None = None
    ) -> Frame:
        """Fill a frame from the ring or, if the line moves otherwise than it did for the ring, by rendering."""
        rows = np.arange(self.frame_shape[0], dtype=np.float64) if line_rows is None else line_rows
        self.valid = self.valid and np.allclose(rows, self._line_rows, rtol=0, atol=SAME_LINE_ROWS, equal_nan=True)
        if not self.valid:
            return self.renderer.render(frame_index, out, line_rows=line_rows)
        if out is None:
            out = np.empty(self.frame_shape, np.uint8)
        np.copyto(out, self._frames[frame_index % len(self._frames)])
        return out
