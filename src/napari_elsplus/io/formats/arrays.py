"""Stacks kept as arrays: .npy files (mapped, never unpickled) and OME-Zarr folders."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from napari_elsplus.errors import InputError
from napari_elsplus.io.formats.source import FrameSource, positive

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

_TO_UM = {"micrometer": 1.0, "nanometer": 1e-3, "millimeter": 1e3, "meter": 1e6}
_TO_S = {"second": 1.0, "millisecond": 1e-3, "microsecond": 1e-6, "minute": 60.0}


class NumpyFile(FrameSource):
    """Frames of a .npy file, mapped."""

    def __init__(self, path: Path) -> None:
        array = np.load(path, mmap_mode="r", allow_pickle=False)
        if not isinstance(array, np.memmap):
            array.close()
            raise InputError(f"{path.name} is an archive of arrays", "save one stack with numpy.save")
        super().__init__(path, array.shape, array.dtype)
        self._array: NDArray[Any] = array.reshape(self.shape)

    def frame(self, index: int) -> NDArray[Any]:
        """Read one frame, (rows, cols), as the file holds it."""
        return self._array[index, :, :]

    def close(self) -> None:
        """Let go of the file."""
        self._array = np.empty((0, *self.shape[1:]), self.stored_dtype)


class OmeZarr(FrameSource):
    """Frames of an OME-Zarr image (metadata of zarr format 2 or 3), or of a plain zarr array; full resolution."""

    def __init__(self, path: Path) -> None:
        import zarr

        node = zarr.open(path, mode="r")
        known: dict[str, Any] = {}
        if isinstance(node, zarr.Group):
            node, known = _full_resolution(path, node)
        if not isinstance(node, zarr.Array):
            raise InputError(f"{path.name} holds no array", "name an OME-Zarr image")
        leading = node.shape[:-2]
        if node.ndim < 2 or sum(size > 1 for size in leading) > 1:
            raise InputError(f"{path.name} has shape {node.shape}", "a stack of frames (T, rows, cols) is expected")
        if node.ndim > 3 and node.shape[-4:-2][0] in (3, 4) and "c" in known.get("axes", "")[-4:-2]:
            raise InputError(f"{path.name} has {node.shape} pixels in colour", "save it as grey levels")
        count = int(np.prod(leading, dtype=np.int64))
        super().__init__(path, (count, *node.shape[-2:]), np.dtype(node.dtype), known)
        self._leading = leading
        self._array: Any = node

    def frame(self, index: int) -> NDArray[Any]:
        """Read one frame, (rows, cols), as the file holds it."""
        place: tuple[Any, ...] = np.unravel_index(index, self._leading) if self._leading else ()
        return np.asarray(self._array[(*(int(step) for step in place), ...)])


def _full_resolution(path: Path, group: Any) -> tuple[Any, dict[str, Any]]:
    attributes: Mapping[str, Any] = dict(group.attrs)
    notes = attributes.get("napari-elsplus")
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
    known: dict[str, Any] = {"axes": "".join(axis["name"][:1] for axis in axes)}
    if isinstance(notes, dict):
        known["settings"] = notes
    known |= _scales(axes, scale if transforms else ())
    return group[level["path"]], known


def _scales(axes: Sequence[Mapping[str, Any]], scale: Sequence[float]) -> dict[str, float]:
    known: dict[str, float] = {}
    for axis, step in zip(axes, scale, strict=False):
        unit = axis.get("unit", "")
        if axis["name"] == "x" and unit in _TO_UM and (size := positive(step)):
            known["um_per_px"] = size * _TO_UM[unit]
        if axis["name"] == "t" and unit in _TO_S and (period := positive(step)):
            known["frame_period_s"] = period * _TO_S[unit]
    return known
