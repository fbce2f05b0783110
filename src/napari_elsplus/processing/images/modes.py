"""Image types, and the raw frames that each is made of.

ELSA (sequential ELS): even frames give the confocal view, odd frames the residual view. Frames are counted from the
first of a recording or of a live stream. ELSA image k is the confocal view of frame 2k minus the residual view of frame
2k + 1, so that its rate is half the camera's. Every part that makes or drives ELSA takes the rule from here.

References
----------
Thrapp and Hughes, J. Biomed. Opt. 26, 056501 (2021), doi:10.1117/1.JBO.26.5.056501.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, Protocol

from napari_elsplus.instrument.arguments import Choice

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

FRAMES_PER_IMAGE: Final = 2
"""Raw frames per ELSA image: one for each view (definition of the method)."""


class Frames(Protocol):
    """Sequence of raw frames (rows, cols): an array (T, rows, cols), a list, an open recording."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int, /) -> NDArray[np.generic]: ...


def elsa_frames(index: int) -> tuple[int, int]:
    """Return the numbers of the confocal and of the residual frame of the ELSA image with an index.

    Examples
    --------
    >>> elsa_frames(0), elsa_frames(3)
    ((0, 1), (6, 7))
    """
    confocal = FRAMES_PER_IMAGE * index
    return confocal, confocal + 1


def elsa_pair(frame_number: int) -> tuple[int, int]:
    """Return the numbers of the confocal and of the residual frame of the ELSA image that uses a frame number.

    Examples
    --------
    >>> elsa_pair(6), elsa_pair(7)
    ((6, 7), (6, 7))
    """
    return elsa_frames(frame_number // FRAMES_PER_IMAGE)


class Mode(Choice):
    """Image type that is made of raw frames."""

    LS = "ls"
    """Confocal view alone: line-scan confocal."""
    RESIDUAL = "residual"
    """Residual view, aligned with the confocal one and divided by the residual gain."""
    ELS = "els"
    """Confocal minus residual of one frame: ELS+."""
    ELSA = "elsa"
    """Confocal of one frame minus residual of the next: sequential ELS, for comparison."""

    @property
    def label(self) -> str:
        """Display name, as in the paper."""
        return {Mode.RESIDUAL: "residual", Mode.ELS: "ELS+"}.get(self, self.value.upper())

    @property
    def frames_per_image(self) -> int:
        """Raw frames from which one image is made, in non-overlapping groups: 2 for ELSA, otherwise 1."""
        return FRAMES_PER_IMAGE if self is Mode.ELSA else 1

    def source_frames(self, index: int) -> tuple[int, int]:
        """Return the numbers of the raw frames of the confocal and of the residual view of the image with an index."""
        return elsa_frames(index) if self is Mode.ELSA else (index, index)


COMPARED_MODES: Final[tuple[Mode, ...]] = (Mode.LS, Mode.ELSA, Mode.ELS)
"""Those that are compared, from left to right."""


def frames_in_turn(raw: Frames, mode: Mode) -> Frames:
    """Return the frames of which image k of a mode is made of raw frame k, not of non-overlapping groups.

    Parameters
    ----------
    raw : Frames
        Raw frames (rows, cols).
    mode : Mode
        ELSA takes its residual from the frame after each; for the last one, from the frame before.
    """
    return _Successive(raw) if mode is Mode.ELSA else raw


class _Successive:
    """Pairs of raw frames: each with the next, the last one with the previous."""

    def __init__(self, raw: Frames) -> None:
        self._raw = raw

    def __len__(self) -> int:
        return Mode.ELSA.frames_per_image * len(self._raw)

    def __getitem__(self, index: int, /) -> NDArray[np.generic]:
        frame, after = divmod(index, Mode.ELSA.frames_per_image)
        return self._raw[frame + after if frame + after < len(self._raw) else frame - 1]
