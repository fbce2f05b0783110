from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import numpy as np
import pytest

from napari_elsplus.errors import InputError
from napari_elsplus.io import ImageMetadata, open_recording, write_images

if TYPE_CHECKING:
    from pathlib import Path


def test_a_missing_decoder_is_named_with_its_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    monkeypatch.setitem(sys.modules, "zarr", None)
    (tmp_path / "a.avi").write_bytes(b"RIFF")
    with pytest.raises(InputError, match=r'^AVI files need the extra `video`: pip install "napari-elsplus\[video\]"$'):
        open_recording(tmp_path / "a.avi")
    (tmp_path / "a.zarr").mkdir()
    (tmp_path / "a.zarr" / "zarr.json").write_text("{}")
    with pytest.raises(InputError, match=r"^OME-Zarr images need the extra `zarr`"):
        open_recording(tmp_path / "a.zarr")
    with pytest.raises(InputError, match="extra `zarr`"):
        write_images(tmp_path / "b.zarr", [np.zeros((4, 4), np.uint8)], ImageMetadata())
