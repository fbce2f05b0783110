"""Images that are written in parts, in any order, make the file that is written from first to last."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Callable
from itertools import repeat
from pathlib import Path

import numpy as np
import pytest

from napari_elsplus.errors import InputError
from napari_elsplus.io import ImageMetadata, allocate_images, fill_images, open_recording, write_images, write_mosaic
from pairs import calibration

IMAGES = np.random.default_rng(3).normal(size=(7, 20, 30)).astype(np.float32)
METADATA = ImageMetadata(calibration=calibration(), settings={"mode": "els"})


@pytest.mark.parametrize("suffix", [".ome.tif", ".ome.zarr"])
def test_parts_make_the_file_of_all_images(tmp_path: Path, suffix: str) -> None:
    parts, whole = (tmp_path / f"{name}{suffix}" for name in ("parts", "whole"))
    allocate_images(parts, IMAGES.shape, np.float32, METADATA)  # type: ignore[arg-type]
    for part in (slice(5, 7), slice(0, 2), slice(2, 5)):
        assert fill_images(parts, part.start, iter(IMAGES[part])) == part.stop - part.start
    write_images(whole, IMAGES, METADATA)  # type: ignore[arg-type]
    with open_recording(parts) as filled, open_recording(whole) as written:
        np.testing.assert_array_equal(filled[:], IMAGES)
        assert filled.metadata == written.metadata
        assert filled.calibration == written.calibration


@pytest.mark.parametrize("suffix", [".ome.tif", ".ome.zarr"])
def test_images_that_the_file_has_no_place_for_are_refused(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    allocate_images(path, IMAGES.shape, np.float32)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="exists"):
        allocate_images(path, IMAGES.shape, np.float32)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"an image is \(20, 29\)"):
        fill_images(path, 0, [IMAGES[0, :, 1:]])
    with pytest.raises(IndexError):
        fill_images(path, 6, IMAGES[5:])
    fill_images(path, 0, np.zeros_like(IMAGES[:6]))
    with open_recording(path) as back:
        np.testing.assert_array_equal(back[6], IMAGES[5])
        assert not back[:6].any()


@pytest.mark.skipif(os.name == "nt", reason="Windows has no timer that interrupts")
@pytest.mark.parametrize("after_s", [0.1, 0.3, 0.5])
@pytest.mark.parametrize("write", [write_images, write_mosaic])
def test_an_interrupted_zarr_leaves_nothing(tmp_path: Path, write: Callable[..., object], after_s: float) -> None:
    """Before: chunks that were still being written stayed, or kept the folder from being removed."""
    image = np.random.default_rng(1).random((2500, 2500)).astype(np.float32)
    written = repeat(image, 10_000) if write is write_images else np.tile(image, (3, 3))

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGALRM, interrupt)
    signal.setitimer(signal.ITIMER_REAL, after_s)
    try:
        with pytest.raises(KeyboardInterrupt):
            write(tmp_path / "a.ome.zarr", written, METADATA)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
    assert not list(tmp_path.iterdir())


def test_an_image_is_named_after_the_whole_name_of_its_file(tmp_path: Path) -> None:
    pytest.importorskip("zarr")
    path = tmp_path / "2026.01.05 skin.ome.zarr"
    write_images(path, np.zeros((2, 8, 8), np.float32))
    attributes = json.loads((path / "zarr.json").read_text())["attributes"]
    assert attributes["ome"]["multiscales"][0]["name"] == "2026.01.05 skin"
