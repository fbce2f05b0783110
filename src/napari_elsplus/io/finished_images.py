"""Finished images to a file of any registered format, by the suffix of its name."""

from __future__ import annotations

from dataclasses import replace
from itertools import chain
from operator import length_hint
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from napari_elsplus.errors import InputError
from napari_elsplus.io.atomic import flush, replacing
from napari_elsplus.io.formats.registry import FileFormat, ImageMetadata, format_to_write, recording_stem

if TYPE_CHECKING:
    import os
    from collections.abc import Iterable, Iterator

    from numpy.typing import DTypeLike, NDArray


def write_images(
    path: str | os.PathLike[str],
    images: Iterable[NDArray[Any]],
    metadata: ImageMetadata = ImageMetadata(),  # noqa: B008 - immutable
    *,
    count: int | None = None,
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
    count : int, optional
        Number of images; needed where they have no length.
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
    chosen = format_to_write(Path(path))
    with replacing(path, force=force) as beside:
        return _write(chosen, beside, images, length_hint(images) if count is None else count, _named(metadata, path))


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
    with replacing(path) as beside:
        allocator(beside, shape, np.dtype(dtype), _named(metadata, path))


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
    written = filler(Path(path), first, contiguous_images(images))
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
    with replacing(path, force=force) as beside:
        if image.ndim != 2 or image.size == 0:
            raise InputError(f"the mosaic has shape {image.shape}", "a mosaic (rows, cols) is expected")
        if chosen.pyramid_writer is None:
            _write(chosen, beside, [image], 1, _named(metadata, path))
        else:
            chosen.pyramid_writer(beside, np.ascontiguousarray(image), _named(metadata, path))
    return Path(path)


def _write(chosen: FileFormat, path: Path, images: Iterable[NDArray[Any]], count: int, metadata: ImageMetadata) -> int:
    planes = contiguous_images(images)
    if chosen.writer is not None:
        return chosen.writer(path, planes, metadata)
    assert chosen.allocator is not None
    assert chosen.filler is not None
    first = next(planes)
    chosen.allocator(path, (count, *first.shape), first.dtype, metadata)
    written = chosen.filler(path, 0, chain([first], planes))
    assert written == count
    return written


def _named(metadata: ImageMetadata, path: str | os.PathLike[str]) -> ImageMetadata:
    """Return the metadata with a name of the images: that of their file, unless they have one."""
    return metadata if metadata.name else replace(metadata, name=recording_stem(Path(path).name))


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
