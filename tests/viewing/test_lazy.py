"""Planes are computed when they are looked at, once, within a bound, from any thread."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from napari_elsplus.errors import InputError
from napari_elsplus.viewing import lazy
from napari_elsplus.viewing.lazy import LazyPlanes, UnreadablePlane, image_planes
from napari_elsplus.workflows.sectioning import section
from pairs import calibration, frames


def test_indexing_is_numpys():
    stack = np.random.default_rng(0).random((9, 5, 7))
    planes = LazyPlanes(lambda k: stack[k], stack.shape, stack.dtype)
    for key in (
        0,
        -1,
        np.int64(3),
        slice(2, 5),
        slice(None, None, -2),
        (4, 1),
        (slice(1, 3), slice(0, 2), 3),
        slice(0),
    ):
        np.testing.assert_array_equal(planes[key], stack[key])
        np.testing.assert_array_equal(np.asarray(planes.dask()[key]), stack[key])
    for outside in (9, -10):
        with pytest.raises(IndexError):
            planes[outside]


def test_nothing_is_computed_before_it_is_looked_at_and_then_once():
    asked = []
    planes = LazyPlanes(lambda k: asked.append(k) or np.zeros((4, 4)), (10_000, 4, 4), np.dtype(float))
    view = planes.dask()
    assert asked == []
    for _ in range(3):
        view[77].compute()
    assert asked == [77]


def test_the_cache_has_a_bound(monkeypatch):
    monkeypatch.setattr(lazy, "CACHE_BYTES", 5 * 16 * 8)
    asked = []
    planes = LazyPlanes(lambda k: asked.append(k) or np.zeros((4, 4)), (100, 4, 4), np.dtype(float))
    for k in range(6):
        planes[k]
    planes[5]
    planes[0]
    assert asked == [0, 1, 2, 3, 4, 5, 0]


@pytest.mark.parametrize(("dtype", "empty"), [("u1", 0), ("f4", np.nan)])
def test_a_plane_that_cannot_be_read_is_displayed_as_empty_with_a_warning(dtype, empty):
    """Before: an error, and napari had a layer that it could neither draw nor remove."""

    def read(k):
        if k == 1:
            raise InputError("frame 1 cannot be decoded", "record it again")
        return np.full((4, 5), k, dtype)

    planes = LazyPlanes(read, (3, 4, 5), np.dtype(dtype))
    shown = planes.dask()
    with pytest.warns(UnreadablePlane, match="frame 1 cannot be decoded: record it again"):
        found = np.asarray(shown[1:3, :2])
    np.testing.assert_array_equal(found, np.stack([np.full((2, 5), level) for level in (empty, 2)]))
    assert found.dtype == dtype
    with pytest.raises(InputError, match="decoded"):
        planes[1]


@pytest.mark.parametrize("mode", ["ls", "residual", "els", "elsa"])
def test_threads_get_what_one_after_the_other_gives(mode):
    raw = LazyPlanes(frames(8).__getitem__, (8, 64, 128), np.dtype(np.uint8))
    planes = image_planes(raw, calibration(), mode)
    expected = section(frames(8), calibration(), mode)[:]
    assert planes.shape == expected.shape
    order = list(range(len(planes))) * 3
    with ThreadPoolExecutor(4) as pool:
        for k, plane in zip(order, pool.map(planes.__getitem__, order), strict=True):
            np.testing.assert_array_equal(plane, expected[k])
