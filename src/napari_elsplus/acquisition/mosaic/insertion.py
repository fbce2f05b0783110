"""One image of the live mosaic: frames are inserted as they come, and tiles re-rendered when poses are corrected."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from napari_elsplus.processing.images.modes import elsa_pair
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

    TileKey = tuple[int, tuple[int, int]]
    """Segment, and (row, col) of a tile."""


class TrackedFrame(NamedTuple):
    """A frame of the live track.

    Parameters
    ----------
    frame : int
        Index in the track.
    number : int
        The camera's number, since the first frame.
    pose : Pose
        As tracked.
    place : Pose
        As corrected by the loop closures so far.
    """

    frame: int
    number: int
    pose: Pose
    place: Pose


class LiveInsertion:
    """The mosaics of one image, and the keyframes from which they can be re-rendered.

    Parameters
    ----------
    pipeline : Pipeline
        Makes the images, and holds the mosaics.
    max_keyframes : int
        Keyframes that are kept; 0 for none.
    board : MosaicBoard, optional
        Holds the tiles in shared memory.
    image : int
        The image's number on the board.

    Attributes
    ----------
    kept : KeyframeStore
        Keyframes from which the mosaics can be re-rendered.
    """

    def __init__(
        self, pipeline: Pipeline, max_keyframes: int, board: MosaicBoard | None = None, image: int = 0
    ) -> None:
        self.pipeline, self._board, self._image = pipeline, board, image
        self._keeps = max_keyframes > 0
        self._removals = 0
        self.kept = KeyframeStore(pipeline.grid.diameter, max_keyframes)
        self._inserted: dict[int, Pose] = {}
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
        """Insert a frame if it was tracked.

        Parameters
        ----------
        found : TrackedFrame
            The frame with its poses.
        raw : numpy.ndarray
            (rows, cols).
        image : numpy.ndarray, optional
            Its image, where there is one already.
        keep : bool
            Keep it as a keyframe, however near the last one is.
        """
        if found.place.state is TrackingState.TRACKED:
            self._insert(found, self.pipeline.tracking.image(raw, raw) if image is None else image, keep=keep)

    def _insert(self, found: TrackedFrame, image: NDArray[np.float32], *, keep: bool = False) -> None:
        mosaic = self.pipeline.insert(lambda: image, found.place)
        assert mosaic is not None, "a frame that was not tracked has no pose"
        self._newest = found, image
        self._publish(found.place.segment, mosaic)
        if self._keeps and self.kept.add(found.frame, found.pose, image, mosaic.exposure, always=keep):
            self._inserted[found.frame] = found.place

    def thin(self, corrections: Corrections, lock: AbstractContextManager[Any]) -> None:
        """Discard keyframes where there are too many.

        Parameters
        ----------
        corrections : Corrections
            Of the poses.
        lock : context manager
            Held while the store is changed.
        """
        if not self.kept.needs_thinning:
            return
        self.kept.thin(lambda one: corrections.of(one.frame, one.pose), lock)
        with lock:
            self._forget_discarded()

    def rerender(self, corrections: Corrections, limit_px: float, lock: AbstractContextManager[Any]) -> bool:
        """Re-render the tiles with a frame displaced by more than a limit; return True if there were any.

        Parameters
        ----------
        corrections : Corrections
            Of the poses; already applied to frames that come meanwhile.
        limit_px : float
            Pixels of the mosaic.
        lock : context manager
            Held while frames are inserted; here while one tile is replaced.
        """
        if self.kept.full:
            return False
        with lock:
            frames, removals = self.kept.frames[:], self._removals
            inserted = [self._inserted[one.frame] for one in frames]
        moved = self._displaced(frames, inserted, corrections, limit_px)
        if not moved:
            return False
        places = corrections.of_poses([one.frame for one in frames], [one.pose for one in frames])
        tiles: set[TileKey] = set()
        for k in moved:
            for place in (inserted[k], places[k]):
                tiles |= {(place.segment, key) for key in self._reach(place).tiles()}
        reaches = np.array([(place.segment, *self._reach(place)) for place in places])
        for segment, key in sorted(tiles):
            at = tile_rectangle(*key)
            on_it = (reaches[:, 0] == segment) & (reaches[:, 1] < at.bottom) & (reaches[:, 3] > at.top)
            on_it &= (reaches[:, 2] < at.right) & (reaches[:, 4] > at.left)
            numbers = np.flatnonzero(on_it).tolist()
            tile, rendered = self._render_tile((segment, key), [(frames[k], places[k]) for k in numbers])
            with lock:
                if self._removals != removals:
                    return False
                self._exchange((segment, key), tile, rendered, len(frames), corrections)
        with lock:
            if self._removals == removals:
                self._inserted |= {frames[k].frame: places[k] for k in moved}
        return True

    def remove(self, group: int, segments: Container[int]) -> None:
        """Remove a mosaic and its keyframes.

        Parameters
        ----------
        group : int
            Segment of the mosaic.
        segments : container of int
            Segments of the tracker that lie in it.
        """
        self._removals += 1
        self.pipeline.mosaics.pop(group, None)
        self.kept.discard(segments)
        self._forget_discarded()

    # inside

    def _forget_discarded(self) -> None:
        left = {one.frame for one in self.kept.frames}
        self._inserted = {index: place for index, place in self._inserted.items() if index in left}

    def _displaced(
        self, frames: Sequence[Keyframe], inserted: Sequence[Pose], corrections: Corrections, limit_px: float
    ) -> list[int]:
        """Return the indices of frames that were inserted further than a limit from their corrected poses."""
        if not frames:
            return []
        poses = np.array([one.pose[:3] for one in frames])
        lies = np.array([(*at[:3], at.angle - one.pose.angle) for one, at in zip(frames, inserted, strict=True)])
        numbers = np.array([one.frame for one in frames])
        segment, row, col, angle = corrections.of_frames(numbers, poses[:, 0].astype(np.int64), *poses[:, 1:].T)
        turned_px = np.abs(angle - lies[:, 3]) * self.pipeline.grid.diameter / 2
        off = (segment != lies[:, 0]) | (np.hypot(row - lies[:, 1], col - lies[:, 2]) + turned_px > limit_px)
        return [int(k) for k in np.flatnonzero(off)]

    def _reach(self, place: Pose) -> Rectangle:
        return self._brush.extent_of(place)

    def _render_tile(self, where: TileKey, frames: Iterable[tuple[Keyframe, Pose]]) -> tuple[Tile, list[Rectangle]]:
        """Re-render a tile, beside the one that is displayed."""
        tile, rendered = self._scratch, []
        tile.value[:] = tile.weight[:] = 0
        for one, place in frames:
            rendered += self._render_frame(where, tile, one.image(self._own_image), place)
        return tile, rendered

    def _render_frame(self, where: TileKey, tile: Tile, image: NDArray[np.float32], place: Pose) -> list[Rectangle]:
        segment, key = where
        part = self._reach(place).intersection(tile_rectangle(*key))
        if place.segment != segment or 0 in part.shape:
            return []
        self._brush.render_into(tile, key, image, place)
        return [part]

    def _exchange(
        self, where: TileKey, tile: Tile, rendered: list[Rectangle], known: int, corrections: Corrections
    ) -> None:
        """Add the frames that came meanwhile, and replace the displayed tile."""
        segment, key = where
        mosaic = self.pipeline.mosaics.get(segment)
        if not isinstance(mosaic, Mosaic):
            return
        for one in self.kept.frames[known:]:
            rendered += self._render_frame(where, tile, one.image(self._own_image), corrections.of(one.frame, one.pose))
        if self._newest is not None and mosaic.insertion is Insertion.DEAD_LEAF:
            found, image = self._newest
            rendered += self._render_frame(where, tile, image, corrections.of(found.frame, found.pose))
        mosaic.replace_tile(key, tile, bounding_rectangle(rendered))
        self._publish(segment, mosaic)

    def _publish(self, segment: int, mosaic: Mosaic) -> None:
        """Publish the changed rectangle on the board."""
        if self._board is None:
            return
        dirty = mosaic.take_dirty()
        if dirty is not None:
            self._board.changed(segment, dirty, self._image)


class ElsaInsertion(LiveInsertion):
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
        """Insert the image of a pair at the pose of its confocal frame: :meth:`LiveInsertion.add`."""
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
            self._insert(before, self.pipeline.tracking.image(self._raw, raw))
