"""Lazy arrays of raw frames and images: a plane is computed when it is read."""

from __future__ import annotations

import warnings
from functools import lru_cache
from threading import local
from typing import TYPE_CHECKING, Any, Final

import dask.array as da
import numpy as np

from napari_elsplus.errors import ElsPlusError, InputError
from napari_elsplus.processing.images.cores import CoreFilter
from napari_elsplus.workflows.sectioning import SectionedImages

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from napari_elsplus.instrument.calibration import Calibration
    from napari_elsplus.io import Recording
    from napari_elsplus.processing.images.sectioning import Frames, Mode

CACHE_BYTES: Final = 64 << 20
"""Memory for computed planes of each array, bytes; chosen, 64 MiB or 80 images of 450 x 450 float32."""


class LazyPlanes:
    """An array (T, rows, cols) whose planes are computed when they are read, from any thread.

    Parameters
    ----------
    compute : callable
        Index to plane (rows, cols); called from several threads at once.
    shape : tuple of int
        (T, rows, cols).
    dtype : numpy.dtype
        Data type of the planes.

    Examples
    --------
    >>> planes = LazyPlanes(lambda k: np.full((2, 3), k), (100, 2, 3), np.dtype(int))
    >>> int(planes[7].max()), planes[5:7, 0].tolist()
    (7, [[5, 5, 5], [6, 6, 6]])
    """

    ndim: Final = 3

    def __init__(
        self, compute: Callable[[int], NDArray[Any]], shape: tuple[int, int, int], dtype: np.dtype[Any]
    ) -> None:
        self.shape = shape
        self.dtype = dtype
        plane_bytes = shape[1] * shape[2] * dtype.itemsize
        self._plane = lru_cache(maxsize=max(2, CACHE_BYTES // plane_bytes))(compute)

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, key: Any) -> NDArray[Any]:
        first, *rest = key if isinstance(key, tuple) else (key,)
        if isinstance(first, slice):
            chosen = [self._plane(k) for k in range(*first.indices(len(self)))]
            stack = np.stack(chosen) if chosen else np.empty((0, *self.shape[1:]), self.dtype)
            return stack[(slice(None), *rest)]
        plane: NDArray[Any] = self._plane(range(len(self))[int(first)])[tuple(rest)]
        return plane

    def dask(self) -> da.Array:
        """Return the same planes for display, as a dask array of one chunk each.

        A plane that cannot be read is empty, NaN or 0 of integers, with an :class:`UnreadablePlane` as a warning: an
        error would leave napari with a layer that it can neither draw nor remove.
        """
        return da.from_array(  # type: ignore[no-untyped-call, no-any-return, unused-ignore]
            _Displayed(self),
            chunks=(1, *self.shape[1:]),
            name=False,
            asarray=False,
            inline_array=True,
            meta=np.empty((0, 0, 0), self.dtype),
        )


class UnreadablePlane(InputError, UserWarning):
    """A plane that cannot be read, as a warning where it is displayed; as an error where it is saved."""


class _Displayed:
    """Planes for display, those that cannot be read empty."""

    ndim: Final = 3

    def __init__(self, planes: LazyPlanes) -> None:
        self._planes, self.shape, self.dtype = planes, planes.shape, planes.dtype
        self._empty = np.full((), np.nan if planes.dtype.kind == "f" else 0, planes.dtype)

    def __getitem__(self, key: Any) -> NDArray[Any]:
        try:
            return self._planes[key]
        except ElsPlusError as error:
            warnings.warn(UnreadablePlane(error.problem, error.remedy), stacklevel=2)
            empty: NDArray[Any] = np.broadcast_to(self._empty, self.shape)[key]
            return empty


def raw_planes(recording: Recording) -> LazyPlanes:
    """Return the raw frames of an open recording."""
    return LazyPlanes(recording.__getitem__, recording.shape, recording.dtype)


def image_planes(
    raw: Frames,
    calibration: Calibration,
    mode: Mode | str,
    *,
    cores: CoreFilter | str = CoreFilter.NONE,
    flat_field: bool = False,
) -> LazyPlanes:
    """Return images of one mode, computed from raw frames when they are read.

    Parameters
    ----------
    raw : Frames
        (T, rows, cols), raw.
    calibration : Calibration
        Contains the bundle section.
    mode : Mode or str
        LS, residual, ELS+ or ELSA.
    cores : CoreFilter or str
        Suppression of the core pattern.
    flat_field : bool
        Divide by the flat field.

    Raises
    ------
    CalibrationError
        As :class:`napari_elsplus.workflows.sectioning.SectionedImages`, of which each thread has its own.
    """
    own = local()

    def images() -> SectionedImages:
        if not hasattr(own, "images"):
            own.images = SectionedImages(raw, calibration, mode, cores=cores, flat_field=flat_field)
        made: SectionedImages = own.images
        return made

    return LazyPlanes(lambda index: images()[index], images().shape, np.dtype(np.float32))
