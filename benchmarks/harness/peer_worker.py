"""A peer's side of the pipe: run by its own interpreter, which has none of this project's packages.

Tasks are done with PyFibreBundle as its documentation shows them; what it raises is sent back as its answer.
"""

from __future__ import annotations

import io
import os
import struct
import sys
from importlib import import_module
from time import get_clock_info, perf_counter, thread_time
from typing import Any

import numpy as np

_clock = thread_time if get_clock_info("thread_time").resolution < 1e-6 else perf_counter
_kept: dict[str, Any] = {}
"""Calibrations and masks that a task prepares once."""


_WHOLE = np.float32(256)


def _bundle() -> Any:
    return import_module("pybundle")


def find_shift(earlier: Any, later: Any, template: Any, reach: Any) -> Any:
    """Shift (row, col) and score from ``Mosaic``'s own registration, which has no public name."""
    mosaic = _bundle().Mosaic
    shift, score = mosaic._Mosaic__find_shift(earlier, later, int(template), int(reach))  # noqa: SLF001
    return np.array([shift[1], shift[0], score], float)  # it tells columns first


def calibrate_interpolation(flat: Any, pitch: Any, centre: Any, radius: Any, side: Any) -> Any:
    """Find the cores and prepare triangular interpolation, normalised by the flat field.

    Its compiled kernels cut the cores' values to whole numbers, so that images are scaled up; without a mask they mix
    up two corners of each triangle.
    """
    _kept["interpolation"] = _bundle().calib_tri_interp(
        _WHOLE * flat, float(pitch), int(side), centreX=float(centre), centreY=float(centre), radius=float(radius),
        filterSize=None, normalise=_WHOLE * flat, autoMask=False, mask=True,
    )  # fmt: skip
    return np.array(len(_kept["interpolation"].coreX))


def interpolate(image: Any) -> Any:
    """Triangular interpolation with its numba kernels."""
    return _bundle().recon_tri_interp(_WHOLE * image, _kept["interpolation"], numba=True)


def enhance(flat: Any, frames: Any, pitch: Any, radius: Any) -> Any:
    """Combine shifted frames (T, rows, cols): triangles between the cores of all frames, at shifts that it estimates.

    The image is as large as the bundle is in the frames, twice as fine.
    """
    middle = (len(flat) - 1) / 2
    images = _WHOLE * np.moveaxis(frames, 0, -1)
    how = {
        "centreX": middle, "centreY": middle, "radius": float(radius), "filterSize": None, "normalise": _WHOLE * flat,
        "autoMask": False, "mask": False,
    }  # fmt: skip
    enhanced = _bundle().SuperRes
    calibration = enhanced.calib_multi_tri_interp(_WHOLE * flat, images, float(pitch), 4 * int(radius), **how)
    return enhanced.recon_multi_tri_interp(images, calibration)


def calibrate_edge_filter(side: Any, pitch: Any) -> Any:
    """Prepare the edge filter, its edge between the image and the ring of the honeycomb."""
    _kept["edge"] = _bundle().edge_filter(int(side), 1.3 * float(pitch), 0.2)
    return np.array(0)


def edge_filter(image: Any) -> Any:
    """Filter in Fourier space."""
    return np.asarray(_bundle().filter_image(image, _kept["edge"]))


def gaussian(image: Any, sigma: Any) -> Any:
    """Gaussian filter."""
    return _bundle().g_filter(image, float(sigma))


def find_bundle(image: Any) -> Any:
    """Centre (row, col) and radius of a bundle."""
    x, y, radius = _bundle().find_bundle(image)[:3]
    return np.array([y, x, radius], float)


def start_mosaic(size: Any, blend: Any) -> Any:
    """Start a mosaic, otherwise with its defaults."""
    _kept["mosaic"] = _bundle().Mosaic(int(size), blend=bool(blend), boundaryMethod=_bundle().Mosaic.EXPAND)
    _kept["at"] = np.zeros(2)
    return np.array(0)


def add_to_mosaic(image: Any) -> Any:
    """Add an image; where it says that the probe is (row, col), and its score."""
    mosaic = _kept["mosaic"]
    mosaic.add(image)
    if mosaic.nImages > 1:
        _kept["at"] = _kept["at"] + np.asarray(mosaic.lastShift, float)[::-1]  # it tells columns first
    return np.array([*_kept["at"], getattr(mosaic, "shiftConf", np.nan)])


def mosaic() -> Any:
    """Return the mosaic so far."""
    return _kept["mosaic"].get_mosaic()


def lay(images: Any, places: Any, mask: Any, size: Any, crop: Any, blend: Any) -> Any:
    """Lay images (centre row, col) onto a square canvas with ``Mosaic``'s own insertion, which has no public name."""
    peers = _bundle().Mosaic
    canvas = np.zeros((int(size), int(size)), np.float32)
    for image, place in zip(images, places, strict=True):
        if blend:
            peers._Mosaic__insert_into_mosaic_blended(  # noqa: SLF001
                canvas, image, mask, None, float(crop), 40, (place[0], place[1])
            )
        else:
            peers._Mosaic__insert_into_mosaic(canvas, image, mask.astype(bool), (place[0], place[1]))  # noqa: SLF001
    return canvas


TASKS = {
    task.__name__: task
    for task in (
        find_shift, calibrate_interpolation, interpolate, enhance, calibrate_edge_filter, edge_filter, gaussian,
        find_bundle, start_mosaic, add_to_mosaic, lay, mosaic,
    )
}  # fmt: skip


def answer(task: str, arrays: dict[str, Any]) -> dict[str, Any]:
    """Do one task; whatever a foreign library raises is told, not passed on."""
    try:
        start = _clock()
        result = TASKS[task](**arrays)
        seconds = _clock() - start
    except Exception as error:  # noqa: BLE001 - another program's errors are its answer
        return {"error": np.array(f"{type(error).__name__}: {error!s:.80}")}
    return {"answer": np.asarray(result), "seconds": np.array(seconds)}


def main() -> None:
    """Answer until the pipe closes."""
    out = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # what a library prints must not enter the answers
    import_module("cv2").setNumThreads(1)
    import_module("pybundle")
    while len(length := sys.stdin.buffer.read(8)) == 8:
        with np.load(io.BytesIO(sys.stdin.buffer.read(struct.unpack("<Q", length)[0])), allow_pickle=False) as packed:
            arrays = dict(packed)
        packed_answer = io.BytesIO()
        np.savez(packed_answer, **answer(str(arrays.pop("task")), arrays))
        out.write(struct.pack("<Q", packed_answer.getbuffer().nbytes) + packed_answer.getvalue())
        out.flush()


if __name__ == "__main__":
    main()
