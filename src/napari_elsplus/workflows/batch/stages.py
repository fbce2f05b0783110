"""Stages of a recording in a batch, executed by a worker: its sectioned images; its track and mosaic."""

from __future__ import annotations

import hashlib
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np

from napari_elsplus.errors import CalibrationError
from napari_elsplus.instrument.calibration import ARRAYS
from napari_elsplus.io import Recording, read_calibration
from napari_elsplus.io.calibrations import format_calibration
from napari_elsplus.processing.analysis.image_quality import USED_DIAMETER
from napari_elsplus.processing.calibration.core_agreement import agreement_note
from napari_elsplus.processing.images.sectioning import disc
from napari_elsplus.workflows.batch.spans import SPANS, SpannedImages, split
from napari_elsplus.workflows.batch.tiles import TILE_UM, write_tile
from napari_elsplus.workflows.mosaicing import mosaic
from napari_elsplus.workflows.sectioning import SectionedImages

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.io import TrackPoint
    from napari_elsplus.workflows.batch.job import BatchItem, BatchJob, Values


def _section(item: BatchItem, recording: Recording) -> Values:
    calibration, source = _calibration(item.job, recording)
    images = SectionedImages(recording, calibration, item.job.mode)
    note = agreement_note(recording, calibration)
    values = {"calibration": source, "images": len(images), "warnings": note}
    spans = split(len(images))
    if len(spans) > 1:
        return {SPANS: SpannedImages(item).open(images, spans, values)}
    images.save(item.images, force=True, threads=1)
    return values | _described(images, spans[0], item)


def fill_span(span: range, item: BatchItem, recording: Recording) -> Values:
    """Write a span of the images of a long recording into their unfinished file; return what is found in it.

    Parameters
    ----------
    span : range
        Indices of the images.
    item : BatchItem
        The recording.
    recording : Recording
        The same, open.
    """
    calibration, _ = _calibration(item.job, recording)
    images = SectionedImages(recording, calibration, item.job.mode)
    images.fill(SpannedImages(item).file, span)
    return _described(images, span, item)


def _described(images: SectionedImages, span: range, item: BatchItem) -> Values:
    """Return the contrast of the middle image, if it is in a span, and make it the recording's picture."""
    place = len(images) // 2
    if place not in span:
        return {}
    middle = images[place]
    tile = {} if item.job.mosaic else {TILE_UM: write_tile(item.tile, middle, images.calibration.um_per_px)}
    return {"contrast": _contrast(middle), **tile}


def _mosaic(item: BatchItem, recording: Recording) -> Values:
    calibration, source = _calibration(item.job, recording)
    result = mosaic(recording, calibration, item.job.mode, threads=1)
    result.save(item.mosaic, item.track, force=True)
    um = np.nan if result.um_per_px is None else result.um_per_px
    return {
        "calibration": source,
        "frames": len(result.track),
        "tracked": sum(point.state == "tracked" for point in result.track),
        "segments": result.segments,
        "path_um": _path_um(result.track),
        "area_um2": float(np.count_nonzero(result.image)) * um**2,
        "warnings": "; ".join(result.notes),
        TILE_UM: write_tile(item.tile, result.image, result.um_per_px),
    }


STAGES: Final = {"section": _section, "mosaic": _mosaic}


def _calibration(job: BatchJob, recording: Recording) -> tuple[Calibration, str]:
    """Return the calibration of a recording and, for the table, its file or where it was found, with its digest."""
    if job.calibration is not None:
        found, file = read_calibration(job.calibration), Path(job.calibration)
    else:
        own, beside = recording.find_calibration()
        if own is None:
            raise CalibrationError("no calibration lies beside the recording or in it", "give one with -c")
        found, file = own, beside or recording.path
    digest = hashlib.sha256(format_calibration(found).encode())
    for array in (getattr(found, name) for name in ARRAYS):
        digest.update(b"" if array is None else array.tobytes())
    return found, f"{file.name} ({digest.hexdigest()[:8]})"


def _contrast(image: NDArray[np.float32]) -> float:
    """Return the standard deviation of an image (n, n) over its mean, in the disc of 90 % of its width."""
    inside = image[disc(len(image), USED_DIAMETER * len(image))]
    mean = float(np.nanmean(inside))
    return float(np.nanstd(inside)) / mean if mean > 0 else float("nan")


def _path_um(track: Sequence[TrackPoint]) -> float:
    """Return the length of the path within segments, micrometres; NaN without a scale or a tracked pair."""
    tracked: list[Any] = [point for point in track if point.state == "tracked"]
    steps = [np.hypot(b.row_um - a.row_um, b.col_um - a.col_um) for a, b in pairwise(tracked) if a.segment == b.segment]
    return float(np.sum(steps)) if steps else float("nan")


@contextmanager
def single_threaded() -> Iterator[None]:
    """Let OpenCV compute on the caller's thread alone: a worker has one core."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)
