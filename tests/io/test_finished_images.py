"""Images that are written in parts, in any order, make the file that is written from first to last."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from napari_elsplus.errors import InputError
from napari_elsplus.io import ImageMetadata, allocate_images, fill_images, open_recording, write_images
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
    with open_recording(path) as back:
        np.testing.assert_array_equal(back[6], IMAGES[5])
        assert not back[:6].any()
