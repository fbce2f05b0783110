"""Recordings of this software: BigTIFF, one uncompressed page per frame, every page of the same length.

Frame k lies at a constant stride: only the first page is parsed, and frames are views into the mapping. Times and
numbers, far apart, are read once, when somebody asks. After a crash the pages are complete up to some page, which
bisection finds.
"""

from __future__ import annotations

from bisect import bisect_left
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from napari_elsplus.io.formats import ome_xml as ome
from napari_elsplus.io.formats.source import FrameSource
from napari_elsplus.io.formats.tiff_pages import STAMP_TAG
from napari_elsplus.io.stored_frames import StoredFrames

if TYPE_CHECKING:
    import io
    from pathlib import Path

    import tifffile
    from numpy.typing import NDArray

_ENTRY: Final = 20
"""Bytes of a tag in BigTIFF (its specification)."""
_COUNT: Final = 8
"""Bytes of the number of tags in BigTIFF (its specification)."""


class StridedTiff(FrameSource):
    """Frames of a recording of this software."""

    def __init__(self, path: Path, first: tifffile.TiffPage, size: int) -> None:
        rows, cols = first.shape
        dtype = np.dtype(first.parent.byteorder + first.dtype.char)  # type: ignore[union-attr]
        tags = first.tags
        self._ifd = first.offset
        self._head = first.dataoffsets[0] - first.offset
        self._pointer = tags[273].offset + _ENTRY - 8 - first.offset
        frame_bytes = rows * cols * dtype.itemsize
        with path.open("rb") as file:
            following = _word(file, self._ifd + _COUNT + _ENTRY * _word(file, self._ifd)) - self._ifd
            self._stride = following if following > 0 else self._head + frame_bytes
            pages = self._whole_pages(file, size - self._head - frame_bytes)
        super().__init__(path, (pages, rows, cols), dtype, _metadata(first) | {"times_s": None})  # the pages have them
        self._stored = StoredFrames(path, (rows, cols), dtype, first.dataoffsets[0], self._stride)
        self._stamp = tags[STAMP_TAG].valueoffset

    def frame(self, index: int) -> NDArray[Any]:
        """Return frame `index`, (rows, cols)."""
        return self._stored.frame(index)

    def times_s(self) -> NDArray[np.float64]:
        """Return the time of each frame in seconds, (T,), from its page."""
        return self._stamps[:, 0].copy()

    def frame_numbers(self) -> NDArray[np.int64]:
        """Return the camera's number of each frame, (T,), from its page."""
        return self._stamps[:, 1].astype(np.int64)

    @cached_property
    def _stamps(self) -> NDArray[np.float64]:
        """Time in seconds and the camera's number of each frame, (T, 2)."""
        places = range(self._stamp, self._stamp + self.shape[0] * self._stride, self._stride)
        return self._stored.scattered(places, (2,), "<f8")

    def _whole_pages(self, file: io.BufferedReader, last: int) -> int:
        """Return the number of complete pages, which begin at offset `last` at most; later ones a crash cut off."""
        most = max((last - self._ifd) // self._stride + 1, 1)
        return bisect_left(range(most), True, lo=1, key=lambda index: self._is_cut_off(file, index))

    def _is_cut_off(self, file: io.BufferedReader, index: int) -> bool:
        ifd = self._ifd + index * self._stride
        same_tags = _word(file, ifd) == _word(file, self._ifd)
        return not (same_tags and _word(file, ifd + self._pointer) == ifd + self._head)

    def close(self) -> None:
        """Close the file."""
        self._stored.close()


def is_strided(first: tifffile.TiffPage) -> bool:
    """Return True if the `first` page of a file has the layout of this software's recordings."""
    import tifffile

    stamp = first.tags.get(STAMP_TAG)
    return (
        stamp is not None
        and stamp.dtype == tifffile.DATATYPE.DOUBLE
        and stamp.count == 2
        and first.parent.is_bigtiff
        and first.parent.byteorder == "<"
        and first.compression == 1
        and len(first.shape) == 2
        and len(first.dataoffsets) == 1
        and 273 in first.tags
    )


def _metadata(first: tifffile.TiffPage) -> dict[str, Any]:
    metadata = ome.parse(first.description) if first.description.rstrip().endswith("OME>") else {}
    return {"software": first.software} | metadata


def _word(file: io.BufferedReader, place: int) -> int:
    file.seek(place)
    return int.from_bytes(file.read(8), "little")
