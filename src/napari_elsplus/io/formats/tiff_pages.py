"""The page of a recording: a TIFF directory, time and number, then the pixels; all pages are of one length.

tifffile lays out one page; every other is the same bytes with its offsets moved on. So a page costs a copy of a few
hundred bytes, and a reader finds page k without reading the k pages before it.
"""

from __future__ import annotations

import io
import struct
from typing import Any, Final

import numpy as np

from napari_elsplus.io.formats.ome_xml import SOFTWARE

STAMP_TAG: Final = 65000
"""Private TIFF tag of each page: time in seconds and frame number, two doubles."""
DESCRIPTION: Final = "napari-elsplus raw frame"
_TAG_BYTES: Final = 20
_VALUE: Final = 12
"""Bytes of a tag in BigTIFF, and of these the first of its value or offset, after code, type and count."""


class PageLayout:
    """Offsets of a recording of frames of one shape and type.

    Parameters
    ----------
    frame_shape : tuple of int
        Rows and columns.
    dtype : numpy.dtype
        uint8 or uint16.

    Attributes
    ----------
    file_header : bytes
        First bytes of the file, before the first page.
    stride : int
        Bytes from one page to the next.
    padding : bytes
        Bytes after the pixels of a page.

    Examples
    --------
    >>> layout = PageLayout((524, 1328), np.dtype(np.uint8))
    >>> layout.stride - 524 * 1328 < 500
    True
    """

    def __init__(self, frame_shape: tuple[int, int], dtype: np.dtype[Any]) -> None:
        import tifffile

        example = _example(frame_shape, dtype)
        with tifffile.TiffFile(io.BytesIO(example)) as file:
            first, second = file.pages.first, file.pages[1]
            self.file_header = example[: first.offset]
            self.stride = second.offset - first.offset
            self._head = example[first.offset : first.dataoffsets[0]]
            self._pointer = 8 + _TAG_BYTES * len(first.tags)
            self._stamp = first.tags[STAMP_TAG].valueoffset - first.offset
            places = [tag.offset - first.offset for tag in first.tags if tag.valueoffset - first.offset > self._pointer]
            strip = first.tags["StripOffsets"].offset - first.offset
            self._offsets = [place + _VALUE for place in (*places, strip)]
        self.padding = bytes(self.stride - len(self._head) - frame_shape[0] * frame_shape[1] * dtype.itemsize)

    def start(self, index: int) -> int:
        """Return the byte offset of page `index`."""
        return len(self.file_header) + index * self.stride

    def head(self, index: int, time_s: float, frame_number: int) -> bytes:
        """Return the bytes before the pixels of a page; its link to the next page is 0.

        Parameters
        ----------
        index : int
            Of the page.
        time_s : float
            Time of the frame.
        frame_number : int
            The camera's number.
        """
        head = bytearray(self._head)
        for place in self._offsets:
            (offset,) = struct.unpack_from("<Q", head, place)
            struct.pack_into("<Q", head, place, offset + index * self.stride)
        struct.pack_into("<Q", head, self._pointer, 0)
        struct.pack_into("<2d", head, self._stamp, time_s, frame_number)
        return bytes(head)

    def link(self, index: int) -> tuple[int, bytes]:
        """Return the byte offset and the bytes of the link to page `index`: in the page before, or the header."""
        if not index:
            return 0, self.file_header
        return self.start(index - 1) + self._pointer, struct.pack("<Q", self.start(index))


def _example(frame_shape: tuple[int, int], dtype: np.dtype[Any]) -> bytes:
    """Return a file of two empty pages, as tifffile writes it."""
    import tifffile

    buffer, frame = io.BytesIO(), np.zeros(frame_shape, dtype)
    with tifffile.TiffWriter(buffer, bigtiff=True, byteorder="<") as writer:
        for _ in range(2):
            writer.write(
                frame, contiguous=False, metadata=None, photometric="minisblack", description=DESCRIPTION,
                software=SOFTWARE, rowsperstrip=frame_shape[0], align=2,
                extratags=[(STAMP_TAG, tifffile.DATATYPE.DOUBLE, 2, (0.0, 0.0), False)],
            )  # fmt: skip
    return buffer.getvalue()
