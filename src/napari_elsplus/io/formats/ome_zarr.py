"""Finished images to OME-Zarr (version 0.5, on zarr 3), one plane per chunk."""

from __future__ import annotations

from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

from napari_elsplus.errors import InputError
from napari_elsplus.io.atomic import replacing
from napari_elsplus.io.formats.ome_tiff import alike
from napari_elsplus.io.formats.ome_xml import SOFTWARE

if TYPE_CHECKING:
    import os
    from collections.abc import Iterable, Mapping

    from numpy.typing import NDArray


def write_ome_zarr(
    path: str | os.PathLike[str],
    images: Iterable[NDArray[Any]],
    *,
    um_per_px: float | None = None,
    frame_period_s: float | None = None,
    metadata: Mapping[str, Any] | None = None,
    force: bool = False,
) -> int:
    """Write equal images to an OME-Zarr folder, one after the other, holding one at a time.

    Parameters
    ----------
    path : path-like
        The folder, NAME.zarr.
    images : iterable of numpy.ndarray, (rows, cols)
        Equal in shape and type.
    um_per_px : float, optional
        Pixel size.
    frame_period_s : float, optional
        Time from one image to the next.
    metadata : mapping, optional
        Anything else to keep; must be fit for JSON.
    force : bool
        Whether an existing folder may be replaced.

    Returns
    -------
    int
        Number of images written.

    Raises
    ------
    InputError
        If there is no image, the images differ, or the folder exists and `force` is not given.

    References
    ----------
    https://ngff.openmicroscopy.org/0.5/
    """
    import zarr

    target = Path(path)
    if target.suffix != ".zarr":
        raise InputError(f"{target.name} is no name for an OME-Zarr folder", "let it end in .zarr")
    with replacing(target, force=force) as beside:
        planes = alike(images)
        first = next(planes)
        group = zarr.open_group(beside, mode="w", zarr_format=3)
        array = group.create_array("0", shape=(0, *first.shape), chunks=(1, *first.shape), dtype=first.dtype)
        count = 0
        for image in chain([first], planes):
            array.resize((count + 1, *first.shape))
            array[count] = image
            count += 1
        group.attrs["ome"] = {
            "version": "0.5",
            "multiscales": [_multiscale(target.name.split(".")[0], um_per_px, frame_period_s)],
        }
        group.attrs["napari-elsplus"] = {"software": SOFTWARE, **(metadata or {})}
    return count


def _multiscale(name: str, um_per_px: float | None, frame_period_s: float | None) -> dict[str, Any]:
    def axis(name: str, kind: str, unit: str | None) -> dict[str, str]:
        return {"name": name, "type": kind} | ({"unit": unit} if unit else {})

    space_unit = "micrometer" if um_per_px else None
    axes = [
        axis("t", "time", "second" if frame_period_s else None),
        axis("y", "space", space_unit),
        axis("x", "space", space_unit),
    ]
    scale = [frame_period_s or 1.0, um_per_px or 1.0, um_per_px or 1.0]
    datasets = [{"path": "0", "coordinateTransformations": [{"type": "scale", "scale": scale}]}]
    return {"name": name, "axes": axes, "datasets": datasets}
