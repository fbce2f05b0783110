"""Finished images to OME-TIFF: stacks of any length, streamed, and mosaics with an image pyramid."""

from __future__ import annotations

from collections.abc import Sized
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from napari_elsplus.errors import InputError
from napari_elsplus.io.atomic import refuse_existing, replacing
from napari_elsplus.io.disk import SpanWriter
from napari_elsplus.io.formats import ome_xml as ome
from napari_elsplus.io.formats.registry import ImageMetadata

if TYPE_CHECKING:
    import os
    from collections.abc import Iterable, Iterator

    from numpy.typing import DTypeLike, NDArray

MAX_CLASSIC_BYTES: Final = 2 << 30
"""Pixels of a classic TIFF; what is larger, or of unknown length, is written as BigTIFF. Half of what 32-bit offsets
address: some readers take them as signed."""
MAX_SMALLEST_LEVEL_PX: Final = 512
"""Longer side of the smallest level of a pyramid. Chosen: viewers draw such an image at once."""
_PAGE: Final[dict[str, Any]] = {
    "photometric": "minisblack", "metadata": None, "software": ome.SOFTWARE, "description": ome.SOFTWARE,
}  # fmt: skip
"""What tifffile writes into each page of a stack."""
TILE_PX: Final = (256, 256)
"""Rows and columns of a tile; usual for OME-TIFF, and a multiple of 16 as TIFF demands."""


def write_stack(
    path: str | os.PathLike[str],
    images: Iterable[NDArray[Any]],
    metadata: ImageMetadata = ImageMetadata(),  # noqa: B008 - immutable
    *,
    force: bool = False,
) -> int:
    """Write images to an OME-TIFF of any name; parameters and errors as of :func:`napari_elsplus.io.write_images`."""
    import tifffile

    with replacing(path, force=force) as beside:
        planes = contiguous_images(images)
        first = next(planes)
        planes = chain([first], planes)
        if isinstance(images, Sized):
            shape = (len(images), *first.shape)
            _lay_out(beside, shape, first.dtype, metadata)
            return fill_stack(beside, 0, planes)
        count = 0
        with tifffile.TiffWriter(beside, bigtiff=True) as writer:
            for image in planes:
                writer.write(image, contiguous=True, **_PAGE)
                count += 1
        ome.put_into_first_page(beside, (count, *first.shape), first.dtype, metadata)
    return count


def allocate_stack(
    path: str | os.PathLike[str],
    shape: tuple[int, int, int],
    dtype: DTypeLike,
    metadata: ImageMetadata,
) -> None:
    """Create an OME-TIFF of zeros; parameters and errors as of :func:`napari_elsplus.io.allocate_images`."""
    refuse_existing(path)
    _lay_out(Path(path), shape, np.dtype(dtype), metadata)


def _lay_out(path: Path, shape: tuple[int, ...], dtype: np.dtype[Any], metadata: ImageMetadata) -> None:
    import tifffile

    pixel_bytes = int(np.prod(shape, dtype=np.int64)) * dtype.itemsize
    with tifffile.TiffWriter(path, bigtiff=pixel_bytes > MAX_CLASSIC_BYTES) as writer:
        writer.write(shape=shape, dtype=dtype, contiguous=True, **_PAGE)
    ome.put_into_first_page(path, (shape[0], shape[1], shape[2]), dtype, metadata)


def fill_stack(path: str | os.PathLike[str], first: int, images: Iterable[NDArray[Any]]) -> int:
    """Write images into an OME-TIFF; parameters and errors as of :func:`napari_elsplus.io.fill_images`."""
    import tifffile

    with tifffile.TiffFile(path) as file:
        page, count = file.pages.first, len(file.pages)
    assert page.dtype is not None  # every file of allocate_stack has one
    written = 0
    with SpanWriter(Path(path), page.dataoffsets[0] + first * page.nbytes) as pixels:
        for image in contiguous_images(images):
            require_alike(image, path, page.shape, page.dtype)
            if first + written >= count:
                raise IndexError(f"image {first + written} of {count}")
            pixels.write(image)
            written += 1
    return written


def contiguous_images(images: Iterable[NDArray[Any]]) -> Iterator[NDArray[Any]]:
    """Yield the images of a stack, (rows, cols), each contiguous in memory.

    Parameters
    ----------
    images : iterable of numpy.ndarray
        At least one.

    Raises
    ------
    InputError
        If there is none, one is no image (rows, cols), or one differs from the first in shape or type.
    """
    first: NDArray[Any] | None = None
    for count, image in enumerate(images):
        if first is None:
            first = image
        if image.ndim != 2 or image.size == 0:
            raise InputError(f"the images have shape {image.shape}", "a stack of images (rows, cols) is expected")
        if image.shape != first.shape or image.dtype != first.dtype:
            raise InputError(
                f"image {count} is {image.shape}, {image.dtype}, the first {first.shape}, {first.dtype}",
                "write them to files of their own",
            )
        yield np.ascontiguousarray(image)
    if first is None:
        raise InputError("there is no image to write", "is the recording, the layer, or the range of frames empty?")


def require_alike(
    image: NDArray[Any], path: str | os.PathLike[str], shape: tuple[int, ...], dtype: np.dtype[Any]
) -> None:
    """Raise an error if an image differs in shape or type from those of a file.

    Parameters
    ----------
    image : numpy.ndarray
        The image.
    path : path-like
        The file, named in the message.
    shape, dtype
        Rows and columns, and type, of the file's images.

    Raises
    ------
    InputError
        If it does.
    """
    if (image.shape, image.dtype) != (shape, dtype):
        raise InputError(
            f"an image is {image.shape}, {image.dtype}, those of {path} are {shape}, {dtype}",
            "write it to a file of its own",
        )


def write_ome_tiff_pyramid(
    path: str | os.PathLike[str],
    image: NDArray[Any],
    metadata: ImageMetadata,
    *,
    force: bool = False,
) -> Path:
    """Write a mosaic to a tiled OME-TIFF; parameters and errors as of :func:`napari_elsplus.io.write_mosaic`."""
    import tifffile

    with replacing(path, force=force) as beside:
        image = np.ascontiguousarray(image)
        if image.ndim != 2 or image.size == 0:
            raise InputError(f"the mosaic has shape {image.shape}", "a mosaic (rows, cols) is expected")
        fields = ome.tifffile_metadata(metadata, single=True)
        levels = pyramid(image)
        with tifffile.TiffWriter(beside, bigtiff=image.nbytes > MAX_CLASSIC_BYTES, ome=True) as writer:
            for index, level in enumerate(levels):
                writer.write(
                    level, photometric="minisblack", tile=TILE_PX, compression="zlib", software=ome.SOFTWARE,
                    subifds=len(levels) - 1 if index == 0 else None,
                    subfiletype=None if index == 0 else 1,
                    metadata=fields if index == 0 else None,
                )  # fmt: skip
    return Path(path)


def pyramid(image: NDArray[Any]) -> list[NDArray[Any]]:
    """Return an image and its halves (means of 2 x 2 pixels), until the longer side is at most 512 pixels.

    Parameters
    ----------
    image : numpy.ndarray, (rows, cols)
        Full resolution.

    Returns
    -------
    list of numpy.ndarray
        The image itself and its halves, largest first, all of its type.

    Examples
    --------
    >>> [level.shape for level in pyramid(np.zeros((1500, 1100), np.float32))]
    [(1500, 1100), (750, 550), (375, 275)]
    """
    levels = [image]
    while max(levels[-1].shape) > MAX_SMALLEST_LEVEL_PX and min(levels[-1].shape) > 1:
        last = levels[-1]
        rows, cols = last.shape[0] // 2, last.shape[1] // 2
        quads = last[: 2 * rows, : 2 * cols].reshape(rows, 2, cols, 2).astype(np.float32)
        levels.append(quads.mean(axis=(1, 3)).astype(image.dtype))
    return levels
