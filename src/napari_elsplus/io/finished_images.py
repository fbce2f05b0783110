"""Finished images to a file of any registered format, by the suffix of its name."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from napari_elsplus.io.atomic import flush
from napari_elsplus.io.formats.registry import ImageMetadata, format_to_write

if TYPE_CHECKING:
    import os
    from collections.abc import Iterable

    from numpy.typing import DTypeLike, NDArray


def write_images(
    path: str | os.PathLike[str],
    images: Iterable[NDArray[Any]],
    metadata: ImageMetadata = ImageMetadata(),  # noqa: B008 - immutable
    *,
    force: bool = False,
) -> int:
    """Write images of one shape and type, one at a time in memory, in the format that the suffix names.

    Parameters
    ----------
    path : path-like
        ``NAME.ome.tif`` for OME-TIFF, ``NAME.ome.zarr`` for OME-Zarr, or a suffix of another registered format.
    images : iterable of numpy.ndarray, (rows, cols)
        Equal in shape and type.
    metadata : ImageMetadata
        Pixel size, settings, calibration; nothing by default.
    force : bool
        Replace an existing file instead of refusing it.

    Returns
    -------
    int
        Number of images written.

    Raises
    ------
    InputError
        If no format writes the suffix, there is no image, the images differ, or the file exists and `force` is not
        given.
    """
    writer = format_to_write(Path(path)).writer
    assert writer is not None
    return writer(path, images, metadata, force=force)


def allocate_images(
    path: str | os.PathLike[str],
    shape: tuple[int, int, int],
    dtype: DTypeLike,
    metadata: ImageMetadata = ImageMetadata(),  # noqa: B008 - immutable
) -> None:
    """Create the file of a stack of images, whose pixels are 0, in the format that the suffix names.

    Filled by :func:`fill_images`, in any order and by any number of processes, it has the contents that
    :func:`write_images` writes.

    Parameters
    ----------
    path : path-like
        The file, which does not exist: OME-TIFF or OME-Zarr.
    shape : tuple of int
        Number of images, rows, columns.
    dtype : dtype-like
        Of the pixels.
    metadata : ImageMetadata
        As :func:`write_images`.

    Raises
    ------
    InputError
        If the file exists, or no format writes the suffix.
    """
    allocator = format_to_write(Path(path)).allocator
    assert allocator is not None
    allocator(path, shape, dtype, metadata)


def fill_images(path: str | os.PathLike[str], first: int, images: Iterable[NDArray[Any]]) -> int:
    """Write successive images into a file of :func:`allocate_images`, one at a time in memory, and flush it.

    Parameters
    ----------
    path : path-like
        The file.
    first : int
        Index of the first image.
    images : iterable of numpy.ndarray, (rows, cols)
        Of the shape and type of the file's.

    Returns
    -------
    int
        Number of images written.

    Raises
    ------
    InputError
        If an image differs in shape or type from those of the file.
    IndexError
        If there are more images than the file has from the first on.
    """
    filler = format_to_write(Path(path)).filler
    assert filler is not None
    written = filler(path, first, images)
    flush(Path(path))
    return written


def write_mosaic(
    path: str | os.PathLike[str],
    image: NDArray[Any],
    metadata: ImageMetadata = ImageMetadata(),  # noqa: B008 - immutable
    *,
    force: bool = False,
) -> Path:
    """Write a mosaic in the format that the suffix names, with a pyramid of halved levels where the format has one.

    Parameters
    ----------
    path : path-like
        ``NAME.ome.tif`` for OME-TIFF, ``NAME.ome.zarr`` for OME-Zarr, or a suffix of another registered format.
    image : numpy.ndarray, (rows, cols)
        The mosaic at full resolution; pixels that were never covered are 0.
    metadata : ImageMetadata
        Pixel size, settings, calibration; nothing by default.
    force : bool
        Replace an existing file instead of refusing it.

    Returns
    -------
    pathlib.Path
        The file.

    Raises
    ------
    InputError
        If no format writes the suffix, the image is no mosaic, or the file exists and `force` is not given.
    """
    chosen = format_to_write(Path(path))
    if chosen.pyramid_writer is not None:
        return chosen.pyramid_writer(path, image, metadata, force=force)
    assert chosen.writer is not None
    chosen.writer(path, [image], metadata, force=force)
    return Path(path)
