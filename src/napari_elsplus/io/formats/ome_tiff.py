"""Finished images to OME-TIFF: stacks of any length, streamed, and mosaics with an image pyramid."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from napari_elsplus.errors import InputError
from napari_elsplus.io.disk import SpanWriter, require_room
from napari_elsplus.io.formats import ome_xml as ome

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from napari_elsplus.io.formats.registry import ImageMetadata, Images

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


def allocate_stack(path: Path, shape: tuple[int, int, int], dtype: np.dtype[Any], metadata: ImageMetadata) -> None:
    """Create an OME-TIFF of zeros; parameters as of :func:`napari_elsplus.io.allocate_images`."""
    import tifffile

    pixel_bytes = int(np.prod(shape, dtype=np.int64)) * dtype.itemsize
    require_room(path, pixel_bytes)
    with tifffile.TiffWriter(path, bigtiff=pixel_bytes > MAX_CLASSIC_BYTES) as writer:
        writer.write(shape=shape, dtype=dtype, contiguous=True, **_PAGE)
    ome.put_into_first_page(path, shape, dtype, metadata)


def fill_stack(path: Path, first: int, images: Images) -> int:
    """Write images into an OME-TIFF; parameters and errors as of :func:`napari_elsplus.io.fill_images`."""
    import tifffile

    with tifffile.TiffFile(path) as file:
        page, count = file.pages.first, len(file.pages)
    assert page.dtype is not None  # every file of allocate_stack has one
    written = 0
    with SpanWriter(path, page.dataoffsets[0] + first * page.nbytes) as pixels:
        for image in images:
            require_alike(image, path, page.shape, page.dtype)
            if first + written >= count:
                raise IndexError(f"image {first + written} of {count}")
            pixels.write(image)
            written += 1
    return written


def require_alike(image: NDArray[Any], path: Path, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
    """Raise an error if an image differs in shape or type from those of a file.

    Parameters
    ----------
    image : numpy.ndarray
        The image.
    path : pathlib.Path
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


def write_ome_tiff_pyramid(path: Path, image: NDArray[Any], metadata: ImageMetadata) -> None:
    """Write a mosaic to a tiled OME-TIFF; parameters as of :func:`napari_elsplus.io.write_mosaic`."""
    import tifffile

    fields = ome.tifffile_metadata(metadata, single=True)
    levels = pyramid(image)
    with tifffile.TiffWriter(path, bigtiff=image.nbytes > MAX_CLASSIC_BYTES, ome=True) as writer:
        for index, level in enumerate(levels):
            writer.write(
                level, photometric="minisblack", tile=TILE_PX, compression="zlib", software=ome.SOFTWARE,
                subifds=len(levels) - 1 if index == 0 else None,
                subfiletype=None if index == 0 else 1,
                metadata=fields if index == 0 else None,
            )  # fmt: skip


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
