"""Recordings of this software: BigTIFF, one uncompressed page per frame, every page of the same length.

Frame k lies at a constant stride: only the first page is parsed; frames, times and numbers are views into the mapping.
After a crash the pages are complete up to some page, which bisection finds.
"""

from __future__ import annotations

import mmap
import os
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from napari_elsplus.io.formats import ome_xml as ome
from napari_elsplus.io.formats.source import FrameSource
from napari_elsplus.io.formats.tiff_pages import STAMP_TAG

if TYPE_CHECKING:
    from pathlib import Path

    import tifffile
    from numpy.typing import NDArray

MAX_MAPPED_BYTES: Final = 64 << 20
"""Frames that may stay in memory. Chosen: some hundred frames; the system reads them again in microseconds."""
MAX_CACHED_PART: Final = 0.25
"""Part of the computer's memory: of a longer file, frames that were read one after the other do not stay in it.
Chosen: what is read once displaces nothing; room that is used again and again costs the system least."""
_ENTRY: Final = 20
"""Bytes of a tag in BigTIFF (its specification)."""
_COUNT: Final = 8
"""Bytes of the number of tags in BigTIFF (its specification)."""


class StridedTiff(FrameSource):
    """Frames of a recording of this software, as read-only views into the mapped file."""

    def __init__(self, path: Path, first: tifffile.TiffPage, size: int) -> None:
        import psutil

        rows, cols = first.shape
        dtype = np.dtype(first.parent.byteorder + first.dtype.char)  # type: ignore[union-attr]
        self._file = path.open("rb")
        self._map = mmap.mmap(self._file.fileno(), 0, access=mmap.ACCESS_READ)
        tags = first.tags
        self._ifd = first.offset
        self._head = first.dataoffsets[0] - first.offset
        self._stamp = tags[STAMP_TAG].valueoffset - first.offset
        self._pointer = tags[273].offset + _ENTRY - 8 - first.offset
        self._next = _COUNT + _ENTRY * self._word(self._ifd)
        self._frame_bytes = rows * cols * dtype.itemsize
        self._stride = self._page_length()
        self._is_long = size > MAX_CACHED_PART * psutil.virtual_memory().total
        self._bytes_returned = 0
        self._successive = range(0)
        super().__init__(path, (self._whole_pages(size), rows, cols), dtype, _metadata(first))
        self.metadata.pop("times_s", None)  # the pages have them

    def frame(self, index: int) -> NDArray[Any]:
        """Return frame `index`, (rows, cols), a view of the mapped file."""
        self._release_pages(index)
        return self._frames()[index, :, :]

    def block(self, indices: range) -> NDArray[Any]:
        """Return the frames of a range of indices, (len(indices), rows, cols), a view of the mapped file."""
        view = self._frames()
        stop = indices.stop if indices.stop >= 0 else None
        return view[indices.start : stop : indices.step]

    def times_s(self) -> NDArray[np.float64]:
        """Return the time of each frame in seconds, (T,), from its page."""
        return self._stamps()[:, 0].copy()

    def frame_numbers(self) -> NDArray[np.int64]:
        """Return the camera's number of each frame, (T,), from its page."""
        return self._stamps()[:, 1].astype(np.int64)

    def _frames(self) -> NDArray[Any]:
        return self._view(self._head, self.shape[1:], self.stored_dtype)

    def _stamps(self) -> NDArray[np.float64]:
        return self._view(self._stamp, (2,), np.dtype("<f8"))

    def _view(self, offset: int, shape: tuple[int, ...], dtype: np.dtype[Any]) -> NDArray[Any]:
        inner = np.empty(shape, dtype).strides if len(shape) == 1 else (shape[1] * dtype.itemsize, dtype.itemsize)
        return np.ndarray((self.shape[0], *shape), dtype, self._map, self._ifd + offset, (self._stride, *inner))

    def _release_pages(self, index: int) -> None:
        """Release pages at intervals, so that reading through a long recording does not fill the memory."""
        before = self._successive
        self._successive = range(before.start if index in (before.stop - 1, before.stop) else index, index + 1)
        self._bytes_returned += self._frame_bytes
        if self._bytes_returned <= MAX_MAPPED_BYTES or os.name != "posix":
            return
        self._map.madvise(mmap.MADV_DONTNEED)  # views stay valid: the system reads them again
        if self._is_long and hasattr(os, "posix_fadvise"):
            read = len(self._successive) - 1
            start = self._ifd + self._successive.start * self._stride
            os.posix_fadvise(self._file.fileno(), start, read * self._stride, os.POSIX_FADV_DONTNEED)
        self._bytes_returned, self._successive = 0, range(index, index + 1)

    def _page_length(self) -> int:
        following = self._word(self._ifd + self._next)
        return following - self._ifd if following > self._ifd else self._head + self._frame_bytes

    def _whole_pages(self, size: int) -> int:
        """Return the number of complete pages; after a crash, what follows them is incomplete."""
        low, high = 1, max((size - self._ifd - self._head - self._frame_bytes) // self._stride + 1, 1)
        while low < high:
            middle = (low + high + 1) // 2
            low, high = (middle, high) if self._is_page(middle - 1) else (low, middle - 1)
        return low

    def _is_page(self, index: int) -> bool:
        ifd = self._ifd + index * self._stride
        return self._word(ifd) == self._word(self._ifd) and self._word(ifd + self._pointer) == ifd + self._head

    def _word(self, offset: int) -> int:
        return int.from_bytes(self._map[offset : offset + 8], "little")

    def close(self) -> None:
        """Close the file."""
        self._file.close()
        self._map = mmap.mmap(-1, 1)  # views that were returned keep the old one alive


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
