"""Loop of pre-rendered frames, for machines too slow to render at the frame rate."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from napari_elsplus.errors import InputError
from napari_elsplus.simulation.rendering.renderer import SAME_LINE_ROWS, Renderer

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Frame = NDArray[np.uint8]


class FrameLoop:
    """Loop of pre-rendered frames with the interface of `Renderer`.

    Frame k is frame k modulo n of the loop, so that the probe jumps where the loop closes unless its path does too.
    With other line positions than those it was rendered for, the loop is invalid and frames are rendered, until
    :meth:`refill`. Slit, offset and region belong to the instrument: another instrument needs another loop.

    Parameters
    ----------
    renderer : Renderer
        Renders the frames.
    frames : int
        Length of the loop; 60 frames, a quarter of a second at 240 Hz, take 42 MB.
    line_rows : numpy.ndarray, optional
        (rows,) line positions; see :meth:`Renderer.render`.

    Raises
    ------
    InputError
        If the loop has no frame.

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
        """Name for reports, which distinguishes it from live rendering."""
        return f"ring of {len(self._frames)} pre-rendered frames"

    def refill(self, line_rows: NDArray[np.float64] | None = None) -> None:
        """Render the frames of the loop for other line positions, `line_rows` as of :meth:`Renderer.render`."""
        rows = np.arange(self.frame_shape[0], dtype=np.float64)
        self._line_rows = rows if line_rows is None else line_rows.copy()
        self.valid = True
        for index, frame in enumerate(self._frames):
            self.renderer.render(index, frame, line_rows=line_rows)

    def render(
        self, frame_index: int, out: Frame | None = None, *, line_rows: NDArray[np.float64] | None = None
    ) -> Frame:
        """Copy a frame from the loop, or render it if the loop is invalid; arguments of :meth:`Renderer.render`."""
        rows = np.arange(self.frame_shape[0], dtype=np.float64) if line_rows is None else line_rows
        self.valid = self.valid and np.allclose(rows, self._line_rows, rtol=0, atol=SAME_LINE_ROWS, equal_nan=True)
        if not self.valid:
            return self.renderer.render(frame_index, out, line_rows=line_rows)
        if out is None:
            out = np.empty(self.frame_shape, np.uint8)
        np.copyto(out, self._frames[frame_index % len(self._frames)])
        return out
