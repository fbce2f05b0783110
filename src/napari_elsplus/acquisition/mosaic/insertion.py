"""One image of the live mosaic: laid as frames come, and anew where they turn out to belong."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from napari_elsplus.processing.images.elsa import elsa_pair
from napari_elsplus.processing.mosaicing.keyframe_store import KeyframeStore
from napari_elsplus.processing.mosaicing.mosaic import Insertion, Mosaic
from napari_elsplus.processing.mosaicing.tiles import TILE_PX, Rectangle, Tile, bounding_rectangle, tile_rectangle
from napari_elsplus.processing.tracking.motion.pose import TrackingState

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Sequence
    from contextlib import AbstractContextManager
    from typing import Any

    from numpy.typing import NDArray

    from napari_elsplus.acquisition.mosaic.board import MosaicBoard
    from napari_elsplus.processing.mosaicing.keyframe_store import Keyframe
    from napari_elsplus.processing.tracking.motion.pose import Pose
    from napari_elsplus.processing.tracking.pose_graph.correction import Corrections
    from napari_elsplus.workflows.tracking import Pipeline

    Where = tuple[int, tuple[int, int]]
    """A segment, and the key of a tile."""


class TrackedFrame(NamedTuple):
    """A frame of the live track.

    Parameters
    ----------
    frame : int
        Which of the track it is.
    number : int
        By the camera's count, since the first.
    pose : Pose
        Where the tracker has it.
    place : Pose
        Where it belongs by what is known now.
    """

    frame: int
    number: int
    pose: Pose
    place: Pose


class LiveInsertion:
    """The mosaics of one image, and the frames from which they can be laid anew.

    Parameters
    ----------
    pipeline : Pipeline
        Makes the images, and holds the mosaics.
    most : int
        Frames that are kept at most; 0 for none.
    board : MosaicBoard, optional
        Where the tiles are kept for other processes to see.
    image : int
        The image's number on the board.

    Attributes
    ----------
    kept : KeyframeStore
        Frames from which the mosaics can be laid anew.
    """

    def __init__(self, pipeline: Pipeline, most: int, board: MosaicBoard | None = None, image: int = 0) -> None:
        self.pipeline, self._board, self._image = pipeline, board, image
        self._keeps = most > 0
        self._forgotten = 0
        self.kept = KeyframeStore(pipeline.grid.diameter, most)
        self._laid: dict[int, Pose] = {}
        self._newest: tuple[TrackedFrame, NDArray[np.float32]] | None = None
        self._own_image = np.zeros((pipeline.grid.side,) * 2, np.float32)
        self._brush = pipeline.blank_mosaic()
        self._scratch = Tile(*np.zeros((2, TILE_PX, TILE_PX), np.float32))

    def add(
        self,
        found: TrackedFrame,
        raw: NDArray[np.uint8],
        image: NDArray[np.float32] | None = None,
        *,
        keep: bool = False,
    ) -> None:
        """Lay a frame down if it was tracked.

        Parameters
        ----------
        found : TrackedFrame
            Which frame it is, and where.
        raw : numpy.ndarray
            (rows, cols).
        image : numpy.ndarray, optional
            Its image, where that was made already.
        keep : bool
            Whether it has to be kept, however near the last one is.
        """
        if found.place.state is TrackingState.TRACKED:
            self._lay(found, self.pipeline.image(raw) if image is None else image, keep=keep)

    def _lay(self, found: TrackedFrame, image: NDArray[np.float32], *, keep: bool = False) -> None:
        mosaic = self.pipeline.insert(image, found.place)
        assert mosaic is not None, "a frame that was not tracked has no place"
        self._newest = found, image
        self._tell(found.place.segment, mosaic)
        if self._keeps and self.kept.add(found.frame, found.pose, image, mosaic.exposure, always=keep):
            self._laid[found.frame] = found.place

    def thin(self, corrections: Corrections, lock: AbstractContextManager[Any]) -> bool:
        """Let go of kept frames where there are too many; whether any went."""
        if not self.kept.needs_thinning:
            return False
        gone = self.kept.thin(lambda one: corrections.of(one.frame, one.pose), lock)
        with lock:
            left = {one.frame for one in self.kept.frames}
            self._laid = {index: place for index, place in self._laid.items() if index in left}
        return gone

    def lay_anew(self, corrections: Corrections, limit_px: float, lock: AbstractContextManager[Any]) -> bool:
        """Lay again the tiles on which a frame lies further than a limit from where it belongs; whether there were any.

        Parameters
        ----------
        corrections : Corrections
            Say where frames belong; already in force for frames that come meanwhile.
        limit_px : float
            Pixels of the mosaic.
        lock : context manager
            Held while frames are laid; here for no longer than it takes to exchange a tile.
        """
        if self.kept.full:
            return False
        with lock:
            frames, forgotten = self.kept.frames[:], self._forgotten
            laid = [self._laid[one.frame] for one in frames]
        moved = self._off(frames, laid, corrections, limit_px)
        if not moved:
            return False
        places = [corrections.of(one.frame, one.pose) for one in frames]
        tiles: set[Where] = set()
        for k in moved:
            for place in (laid[k], places[k]):
                tiles |= {(place.segment, key) for key in self._reach(place).tiles()}
        reaches = np.array([(place.segment, *self._reach(place)) for place in places])
        for segment, key in sorted(tiles):
            at = tile_rectangle(*key)
            on_it = (reaches[:, 0] == segment) & (reaches[:, 1] < at.bottom) & (reaches[:, 3] > at.top)
            on_it &= (reaches[:, 2] < at.right) & (reaches[:, 4] > at.left)
            numbers = np.flatnonzero(on_it).tolist()
            tile, drawn = self._drawn((segment, key), [(frames[k], places[k]) for k in numbers])
            with lock:
                if self._forgotten != forgotten:
                    return False
                self._exchange((segment, key), tile, drawn, len(frames), corrections)
        with lock:
            if self._forgotten == forgotten:
                self._laid |= {frames[k].frame: places[k] for k in moved}
        return True

    def forget(self, group: int, segments: Container[int]) -> None:
        """Forget a mosaic, and the kept frames of those of the tracker's segments that lie in it."""
        self._forgotten += 1
        self.pipeline.mosaics.pop(group, None)
        self.kept.discard(segments)
        left = {one.frame for one in self.kept.frames}
        self._laid = {index: place for index, place in self._laid.items() if index in left}

    # inside

    def _off(
        self, frames: Sequence[Keyframe], laid: Sequence[Pose], corrections: Corrections, limit_px: float
    ) -> list[int]:
        """Return which frames do not lie where they belong."""
        if not frames:
            return []
        poses = np.array([one.pose[:3] for one in frames])
        lies = np.array([(*place[:3], place.angle - one.pose.angle) for one, place in zip(frames, laid, strict=True)])
        numbers = np.array([one.frame for one in frames])
        segment, row, col, angle = corrections.of_frames(numbers, poses[:, 0].astype(np.int64), *poses[:, 1:].T)
        turned_px = np.abs(angle - lies[:, 3]) * self.pipeline.grid.diameter / 2
        off = (segment != lies[:, 0]) | (np.hypot(row - lies[:, 1], col - lies[:, 2]) + turned_px > limit_px)
        return [int(k) for k in np.flatnonzero(off)]

    def _reach(self, place: Pose) -> Rectangle:
        return self._brush.extent_of(place.row, place.col, place.velocity, place.angle, place.scale)

    def _drawn(self, where: Where, frames: Iterable[tuple[Keyframe, Pose]]) -> tuple[Tile, list[Rectangle]]:
        """Draw a tile anew, beside the one that is looked at."""
        tile, drawn = self._scratch, []
        tile.value[:] = tile.weight[:] = 0
        for one, place in frames:
            drawn += self._draw(where, tile, one.image(self._own_image), place)
        return tile, drawn

    def _draw(self, where: Where, tile: Tile, image: NDArray[np.float32], place: Pose) -> list[Rectangle]:
        segment, key = where
        part = self._reach(place).intersection(tile_rectangle(*key))
        if place.segment != segment or 0 in part.shape:
            return []
        self._brush.render_into(tile, key, image, place.row, place.col, place.velocity, place.angle, place.scale)
        return [part]

    def _exchange(self, where: Where, tile: Tile, drawn: list[Rectangle], known: int, corrections: Corrections) -> None:
        """Lay what came meanwhile on top, and put the tile where the one is that is looked at."""
        segment, key = where
        mosaic = self.pipeline.mosaics.get(segment)
        if mosaic is None:
            return
        for one in self.kept.frames[known:]:
            drawn += self._draw(where, tile, one.image(self._own_image), corrections.of(one.frame, one.pose))
        if self._newest is not None and mosaic.insertion is Insertion.DEAD_LEAF:
            found, image = self._newest
            drawn += self._draw(where, tile, image, corrections.of(found.frame, found.pose))
        mosaic.replace_tile(key, tile, bounding_rectangle(drawn))
        self._tell(segment, mosaic)

    def _tell(self, segment: int, mosaic: Mosaic) -> None:
        """Tell who looks at the board what was drawn on."""
        if self._board is None:
            return
        dirty = mosaic.take_dirty()
        if dirty is not None:
            self._board.changed(segment, dirty, self._image)


class AlternatingInsertion(LiveInsertion):
    """Insertion of ELSA images: confocal view of a pair's first frame minus residual view of its second."""

    _confocal: TrackedFrame | None = None
    _raw: NDArray[np.uint8] | None = None

    def add(
        self,
        found: TrackedFrame,
        raw: NDArray[np.uint8],
        image: NDArray[np.float32] | None = None,
        *,
        keep: bool = False,
    ) -> None:
        """Insert the image of a pair once its residual frame has come, at the pose of its confocal frame."""
        before, self._confocal = self._confocal, None
        confocal, residual = elsa_pair(found.number)
        if found.number == confocal:
            if found.place.state is TrackingState.TRACKED:
                if self._raw is None:
                    self._raw = np.empty_like(raw)
                np.copyto(self._raw, raw)
                self._confocal = found
        elif before is not None and found.number == residual and before.number == confocal:
            assert self._raw is not None
            self._lay(before, self.pipeline.image(self._raw, raw))
