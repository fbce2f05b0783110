"""Multi-page TIFF files: 8 or 16 bit or float, compressed or not, plain, ImageJ or OME."""

from __future__ import annotations

import logging
from contextlib import contextmanager
from threading import Lock
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from napari_elsplus.errors import InputError
from napari_elsplus.io.formats import ome_xml as ome
from napari_elsplus.io.formats.ome_tiff import allocate_stack, fill_stack, write_ome_tiff_pyramid
from napari_elsplus.io.formats.registry import FileFormat
from napari_elsplus.io.formats.source import FrameSource, decoding, positive
from napari_elsplus.io.formats.strided_tiff import StridedTiff, is_strided
from napari_elsplus.io.stored_frames import StoredFrames

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    import tifffile
    from numpy.typing import NDArray

_IMAGEJ_TO_S: Final = {
    **ome.TO_S,
    **dict.fromkeys(("sec", "second", "seconds"), 1.0),
    **dict.fromkeys(("msec", "millisecond", "milliseconds"), 1e-3),
    **dict.fromkeys(("usec", "microsecond", "microseconds"), 1e-6),
    **dict.fromkeys(("minute", "minutes"), 60.0),
}
"""Seconds in the units of time that ImageJ's users write; an interval in another one is left out."""

logging.getLogger("tifffile").addHandler(logging.NullHandler())  # the errors that it logs are raised here


class PagedTiff(FrameSource):
    """Frames of a TIFF file that other software wrote, decoded one at a time.

    Notes
    -----
    tifffile writes an array of three or four frames as the planes of one colour image, unless it is told otherwise.
    The array's shape, which it notes beside them, says that they are frames. Frames that were written one by one are
    a series each for it; here they are one stack.
    """

    def __init__(self, path: Path, tiff: tifffile.TiffFile) -> None:
        import tifffile

        self._tiff = tiff
        self._lock = Lock()
        tiff.filehandle.set_lock(True)
        with _logged_errors() as errors:
            series = _frames_one_by_one(tiff) or tiff.series
        if errors:
            raise InputError(f"{path.name} is truncated or damaged ({errors[0]:.80})", "copy or record it again")
        first = series[0]
        page = first.keyframe
        self._planes = bool(
            tiff.is_shaped
            and first.axes == "SYX"
            and page.planarconfig == tifffile.PLANARCONFIG.SEPARATE
            and len(first.pages) == 1
        )
        if page.photometric == tifffile.PHOTOMETRIC.PALETTE or (page.samplesperpixel > 1 and not self._planes):
            raise InputError(
                f"{path.name} is a colour image ({page.samplesperpixel} samples per pixel)", "save it as grey levels"
            )
        if page.photometric == tifffile.PHOTOMETRIC.MINISWHITE:
            raise InputError(f"{path.name} is stored with white as 0 (WhiteIsZero)", "save it with black as 0")
        if len(series) > 1:
            shapes = ", ".join(str(one.shape) for one in series[:3])
            raise InputError(f"{path.name} holds {len(series)} image series {shapes}", "save one stack per file")
        self._series = first
        rows, cols = page.imagelength, page.imagewidth
        several = sum(size > 1 for size in first.shape[:-2]) > 1  # planes or channels, which are no moments
        if first.shape[-2:] != (rows, cols) or several:
            raise InputError(
                f"{path.name} has axes {first.axes} {first.shape}", "a stack of frames (T, rows, cols) is expected"
            )
        count = int(np.prod(first.shape[:-2], dtype=np.int64))
        dtype = np.dtype(first.dtype)
        super().__init__(path, (count, rows, cols), dtype, _metadata(tiff))
        offset = first.dataoffset
        self._stored = self._stored_at(offset) if offset is not None else None
        if self._stored is None:
            self._refuse_truncated(count if self._planes else len(first.pages))

    def frame(self, index: int) -> NDArray[Any]:
        """Return frame `index`, (rows, cols), as stored."""
        if self._stored is not None:
            return self._stored.frame(index)
        with self._lock:
            page = self._series.pages[0 if self._planes else index]
            if page is None:
                raise InputError(f"{self.path.name}: frame {index} is missing", "copy or record it again")
            if (part := page.parent.filehandle).closed:  # of a stack in several files; all are closed with the first
                part.open()
                part.set_lock(True)
            with part.lock:  # which decoding holds while it reads
                own = page if page.is_virtual else page.aspage()  # tifffile takes all pages to be like the first
        if own.hash != self._series.keyframe.hash:
            raise InputError(
                f"{self.path.name}: frame {index} is stored otherwise than the first ({own.shape}, {own.dtype})",
                "save one stack per file",
            )
        if 0 in page.dataoffsets or 0 in page.databytecounts:  # which tifffile reads as black
            raise InputError(f"{self.path.name}: frame {index} lacks some of its pixels", "copy or record it again")
        image = page.asarray(maxworkers=1)
        if self._planes:
            return image[index, :, :]
        return image.reshape(self.shape[1:]) if image.size == self.shape[1] * self.shape[2] else image

    def _stored_at(self, offset: int) -> StoredFrames:
        dtype = np.dtype(self._tiff.byteorder + self.stored_dtype.char)
        end = offset + int(np.prod(self.shape, dtype=np.int64)) * dtype.itemsize
        if end > self._tiff.filehandle.size:
            raise InputError(
                f"{self.path.name} is truncated: {self._tiff.filehandle.size} of {end} bytes", "copy or record it again"
            )
        return StoredFrames(self.path, self.shape[1:], dtype, offset)

    def _refuse_truncated(self, pages: int) -> None:
        if pages != self.shape[0]:
            raise InputError(
                f"{self.path.name} is truncated: {pages} of {self.shape[0]} frames", "copy or record it again"
            )
        last = self._series.pages[-1]
        ends = [a + b for a, b in zip(last.dataoffsets, last.databytecounts, strict=False)] if last is not None else []
        if max(ends, default=0) > self._tiff.filehandle.size:
            raise InputError(f"{self.path.name} is truncated in its last frame", "copy or record it again")

    def close(self) -> None:
        """Close the file."""
        if self._stored is not None:
            self._stored.close()
        self._tiff.close()


def open_tiff(path: Path) -> FrameSource:
    """Open the TIFF file at `path`: a recording of this software by its layout, any other page by page.

    Raises
    ------
    InputError
        If it is empty, no TIFF file, truncated, in colour, or holds several image series.
    """
    import tifffile

    size = path.stat().st_size
    if size == 0:  # of a folder's files
        raise InputError(f"{path.name} is empty", "copy or record it again")
    try:
        tiff = tifffile.TiffFile(path)
    except tifffile.TiffFileError:
        raise InputError(f"{path.name} is no TIFF file", "name a recording; its suffix gives its format") from None
    try:
        first = tiff.pages.first
        if is_strided(first):
            with tiff:
                if first.dataoffsets[0] + first.databytecounts[0] > size:
                    raise InputError(f"{path.name} holds no whole frame", "record it again")
                return StridedTiff(path, first, size)
        return PagedTiff(path, tiff)
    except BaseException:
        tiff.close()
        raise


def read_image(path: Path) -> NDArray[Any]:
    """Return the one grey image, (rows, cols), of the TIFF file at `path`."""
    with decoding(path):
        source = open_tiff(path)
        try:
            if source.shape[0] != 1:
                raise InputError(f"{path.name} holds {source.shape[0]} frames", "a folder's files hold one frame each")
            return source.checked(0).copy()
        finally:
            source.close()


def _frames_one_by_one(tiff: tifffile.TiffFile) -> list[tifffile.TiffPageSeries]:
    """Return the pages of a file that was written a frame at a time, each with its own shape noted, as one series."""
    import tifffile

    first = tiff.pages.first
    if len(first.shape) != 2 or len(tiff.pages) == 1:
        return []
    alike = []
    for page in tiff.pages:
        if not isinstance(page, tifffile.TiffPage) or not page.is_shaped or page.hash != first.hash:
            return []
        alike.append(page)
    return [tifffile.TiffPageSeries(alike, (len(alike), *first.shape), first.dtype, "TYX", parent=tiff)]


def _metadata(tiff: tifffile.TiffFile) -> dict[str, Any]:
    first = tiff.pages.first
    metadata: dict[str, Any] = {"software": first.software} if first.software else {}
    if tiff.is_ome and tiff.ome_metadata:
        return metadata | ome.parse(tiff.ome_metadata)
    imagej = tiff.imagej_metadata or {}
    unit_s = _IMAGEJ_TO_S.get(str(imagej.get("tunit", "sec")).lower().replace("\\u00b5", "µ"))
    interval = imagej.get("finterval")
    if unit_s is not None and (period := positive(interval)) is not None:
        metadata["frame_period_s"] = period * unit_s
    resolution = first.tags.get("XResolution")
    if str(imagej.get("unit", "")).strip("\\").lower() in {"um", "micron", "µm", "u00b5m"} and resolution is not None:
        pixels, per = resolution.value
        if (size := positive(per / pixels if pixels else None)) is not None:
            metadata["um_per_px"] = size
    return metadata


@contextmanager
def _logged_errors() -> Iterator[list[str]]:
    """Collect the errors that tifffile logs instead of raising."""
    collected: list[str] = []

    class Collector(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            collected.append(record.getMessage())

    logger, handler = logging.getLogger("tifffile"), Collector(logging.ERROR)
    logger.addHandler(handler)
    try:
        yield collected
    finally:
        logger.removeHandler(handler)


TIFF: Final = FileFormat(
    "TIFF",
    (".tif", ".tiff", ".btf"),
    open_tiff,
    allocator=allocate_stack,
    filler=fill_stack,
    pyramid_writer=write_ome_tiff_pyramid,
    written_suffixes=(".ome.tif", ".tif", ".tiff"),
    signatures=(b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"),
)
