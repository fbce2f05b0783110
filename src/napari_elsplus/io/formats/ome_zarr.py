"""OME-Zarr folders: any version and zarr format are read; stacks and mosaics are written in version 0.5."""

from __future__ import annotations

import json
import warnings
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from itertools import product
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from napari_elsplus.errors import InputError
from napari_elsplus.io.atomic import ZARR_MARKERS
from napari_elsplus.io.formats.extras import extra_needed
from napari_elsplus.io.formats.ome_tiff import TILE_PX, pyramid, require_alike
from napari_elsplus.io.formats.ome_xml import SOFTWARE
from napari_elsplus.io.formats.registry import FileFormat
from napari_elsplus.io.formats.source import FrameSource, positive

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from napari_elsplus.io.formats.registry import ImageMetadata, Images

NOTES: Final = "napari-elsplus"
"""Attribute of the group that keeps settings, software, calibration and times."""
TIMES: Final = "times_s"
"""Key of the images' times among them: the axes of OME-Zarr have a step only."""
_TO_UM: Final = {"micrometer": 1.0, "nanometer": 1e-3, "millimeter": 1e3, "meter": 1e6}
_TO_S: Final = {"second": 1.0, "millisecond": 1e-3, "microsecond": 1e-6, "minute": 60.0}
"""Micrometres and seconds in the units of OME-Zarr."""


class OmeZarr(FrameSource):
    """Frames of an OME-Zarr image (metadata of zarr format 2 or 3), or of a plain zarr array; full resolution."""

    def __init__(self, path: Path) -> None:
        with extra_needed("zarr", "OME-Zarr images"):
            import zarr

        node = zarr.open(path, mode="r")
        metadata: dict[str, Any] = {}
        if isinstance(node, zarr.Group):
            node, metadata = _full_resolution(path, node)
        if not isinstance(node, zarr.Array):
            raise InputError(f"{path.name} holds no array", "name an OME-Zarr image")
        leading = node.shape[:-2]
        if node.ndim < 2 or sum(size > 1 for size in leading) > 1:
            raise InputError(f"{path.name} has shape {node.shape}", "a stack of frames (T, rows, cols) is expected")
        if node.ndim > 3 and node.shape[-4:-2][0] in (3, 4) and "c" in metadata.get("axes", "")[-4:-2]:
            raise InputError(f"{path.name} has {node.shape} pixels in colour", "save it as grey levels")
        count = int(np.prod(leading, dtype=np.int64))
        super().__init__(path, (count, *node.shape[-2:]), np.dtype(node.dtype), metadata)
        self._leading = leading
        self._array: Any = node
        self._absent_warned = False

    def frame(self, index: int) -> NDArray[Any]:
        """Return frame `index`, (rows, cols), as stored."""
        place: tuple[Any, ...] = np.unravel_index(index, self._leading) if self._leading else ()
        image = np.asarray(self._array[(*(int(step) for step in place), ...)])
        if not self._absent_warned and (image == image[:1, :1]).all() and not self._has_chunks(place):
            self._absent_warned = True
            warnings.warn(
                f"{self.path.name} has no file of the pixels of frame {index}, and perhaps of others, which are read "
                f"as {image[0, 0]}: copy it again, unless they are black",
                stacklevel=2,
            )
        return image

    def _has_chunks(self, place: tuple[Any, ...]) -> bool:
        """Return True if a chunk of the frame at a place is in a file; zarr leaves out those of one value."""
        steps = self._array.shards or self._array.chunks
        lead = [range(int(at) // step, int(at) // step + 1) for at, step in zip(place, steps, strict=False)]
        tiles = [range(-(-side // step)) for side, step in zip(self.shape[1:], steps[-2:], strict=True)]
        keys = (self._array.metadata.encode_chunk_key(chunk) for chunk in product(*lead, *tiles))
        return any((self.path / self._array.path / key).exists() for key in keys)


def _full_resolution(path: Path, group: Any) -> tuple[Any, dict[str, Any]]:
    attributes: Mapping[str, Any] = dict(group.attrs)
    notes = attributes.get(NOTES)
    attributes = attributes.get("ome", attributes)
    scales = attributes.get("multiscales")
    if not scales:
        raise InputError(f"{path.name} has no multiscales metadata", "name an OME-Zarr image")
    image = scales[0]
    level = image["datasets"][0]
    axes = [axis if isinstance(axis, dict) else {"name": axis} for axis in image.get("axes", ())]
    transforms = [*level.get("coordinateTransformations", ()), *image.get("coordinateTransformations", ())]
    scale = [1.0] * len(axes)
    for transform in transforms:
        if transform.get("type") == "scale" and len(transform["scale"]) == len(axes):
            scale = [a * b for a, b in zip(scale, transform["scale"], strict=True)]
    metadata: dict[str, Any] = {"axes": "".join(axis["name"][:1] for axis in axes)}
    if isinstance(notes, dict):
        metadata["settings"] = {name: value for name, value in notes.items() if name not in {"calibration", TIMES}}
        times: Any = notes.get(TIMES)
        if isinstance(times, list):
            metadata["times_s"] = [time if isinstance(time, int | float) else None for time in times]
        if "calibration" in notes:
            metadata["calibration"] = json.dumps(notes["calibration"])
    metadata |= _scales(axes, scale if transforms else ())
    return group[level["path"]], metadata


def _scales(axes: Sequence[Mapping[str, Any]], scale: Sequence[float]) -> dict[str, float]:
    metadata: dict[str, float] = {}
    for axis, step in zip(axes, scale, strict=False):
        unit = axis.get("unit", "")
        if axis["name"] == "x" and unit in _TO_UM and (size := positive(step)):
            metadata["um_per_px"] = size * _TO_UM[unit]
        if axis["name"] == "t" and unit in _TO_S and (period := positive(step)):
            metadata["frame_period_s"] = period * _TO_S[unit]
    return metadata


def allocate_ome_zarr(path: Path, shape: tuple[int, int, int], dtype: np.dtype[Any], metadata: ImageMetadata) -> None:
    """Create an OME-Zarr folder of zeros; parameters as of :func:`napari_elsplus.io.allocate_images`.

    A plane is a chunk. Pixel size and frame interval become the scale; settings and calibration, attributes.

    References
    ----------
    https://ngff.openmicroscopy.org/0.5/
    """
    with _new_group(path, metadata) as (group, finishing):
        finishing(_new_array, group, shape, dtype, metadata)


def fill_ome_zarr(path: Path, first: int, images: Images) -> int:
    """Write images into an OME-Zarr folder; parameters and errors as of :func:`napari_elsplus.io.fill_images`."""
    with extra_needed("zarr", "OME-Zarr images"):
        import zarr

    with zarr.config.set({"array.write_empty_chunks": True}):  # one that is absent is lost
        array: Any = zarr.open_group(path, mode="r+")["0"]
    written = 0
    with _finishing() as finishing:
        for image in images:
            require_alike(image, path, array.shape[1:], array.dtype)
            finishing(array.__setitem__, first + written, image)
            written += 1
    return written


def write_ome_zarr_pyramid(path: Path, image: NDArray[Any], metadata: ImageMetadata) -> None:
    """Write a mosaic to an OME-Zarr folder; parameters as of :func:`napari_elsplus.io.write_mosaic`."""
    um_per_px = metadata.um_per_px
    with _new_group(path, metadata) as (group, finishing):
        datasets = []
        for index, level in enumerate(pyramid(image)):
            chunks = tuple(min(side, tile) for side, tile in zip(level.shape, TILE_PX, strict=True))
            array = finishing(group.create_array, str(index), shape=level.shape, chunks=chunks, dtype=level.dtype)
            finishing(array.__setitem__, slice(None), level)
            size, shift_px = (um_per_px or 1.0) * 2**index, (2**index - 1) / 2  # of the first pixel's centre
            scaled = {"type": "scale", "scale": [size] * 2}
            shifted = {"type": "translation", "translation": [shift_px * (um_per_px or 1.0)] * 2}
            datasets.append({"path": str(index), "coordinateTransformations": [scaled, shifted][: 1 + bool(index)]})
        finishing(_describe, group, metadata, _space(um_per_px), datasets)


@contextmanager
def _new_group(path: Path, metadata: ImageMetadata) -> Iterator[tuple[Any, Callable[..., Any]]]:
    """Yield a new group with its settings, software and calibration, and the function by which to write into it."""
    with extra_needed("zarr", "OME-Zarr images"):
        import zarr

    kept: dict[str, Any] = {} if metadata.calibration is None else {"calibration": metadata.calibration.content()}
    if metadata.times_s is not None:
        kept[TIMES] = list(metadata.times_s)
    with _finishing() as finishing:
        group = finishing(zarr.open_group, path, mode="w", zarr_format=3)
        yield group, finishing
        finishing(group.attrs.__setitem__, NOTES, {"software": SOFTWARE, **metadata.settings, **kept})


@contextmanager
def _finishing() -> Iterator[Callable[..., Any]]:
    """Yield a function that calls others, in a thread that finishes them where their caller is interrupted.

    zarr itself goes on writing then, into a folder that is being removed.
    """
    with ThreadPoolExecutor(1, "zarr") as thread:
        yield lambda write, *arguments, **options: thread.submit(write, *arguments, **options).result()


def _new_array(group: Any, shape: tuple[int, int, int], dtype: np.dtype[Any], metadata: ImageMetadata) -> None:
    """Create the array of a stack of images, a chunk each, in a group that has its axes and scale."""
    size, period_s = metadata.um_per_px or 1.0, None if metadata.depth_scan else metadata.frame_period_s
    first = _axis("z", "space", None) if metadata.depth_scan else _axis("t", "time", "second" if period_s else None)
    scaled = {"type": "scale", "scale": [period_s or 1.0, size, size]}
    datasets = [{"path": "0", "coordinateTransformations": [scaled]}]
    _describe(group, metadata, [first, *_space(metadata.um_per_px)], datasets)
    group.create_array("0", shape=shape, chunks=(1, *shape[1:]), dtype=dtype)


def _describe(group: Any, metadata: ImageMetadata, axes: list[dict[str, str]], datasets: list[dict[str, Any]]) -> None:
    multiscale = {"name": metadata.name, "axes": axes, "datasets": datasets}
    group.attrs["ome"] = {"version": "0.5", "multiscales": [multiscale]}


def _space(um_per_px: float | None) -> list[dict[str, str]]:
    return [_axis(name, "space", "micrometer" if um_per_px else None) for name in "yx"]


def _axis(name: str, kind: str, unit: str | None) -> dict[str, str]:
    return {"name": name, "type": kind} | ({"unit": unit} if unit else {})


OME_ZARR: Final = FileFormat(
    "OME-Zarr",
    (".zarr",),
    OmeZarr,
    allocator=allocate_ome_zarr,
    filler=fill_ome_zarr,
    pyramid_writer=write_ome_zarr_pyramid,
    written_suffixes=(".ome.zarr", ".zarr"),
    folder_markers=ZARR_MARKERS,
)
