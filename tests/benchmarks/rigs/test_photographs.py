"""Real photographs through fibre bundles, made by others."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.rigs.photographs import look_at
from napari_elsplus.errors import InputError


def test_real_bundles_are_found_and_lose_their_honeycomb_over_the_flat_field(data_folder: Path) -> None:
    found = {one.name: one for one in look_at(data_folder / "real")}
    assert list(found) == ["bundle1", "tissue_paper", "usaf1"]
    assert np.isnan(found["bundle1"].flattened)
    assert np.isnan(found["bundle1"].moved_px)
    assert found["usaf1"].moved_px < 1
    assert found["usaf1"].flattened < 0.2 * found["usaf1"].honeycomb
    assert found["tissue_paper"].flattened < 0.6 * found["tissue_paper"].honeycomb


def test_a_folder_without_the_photographs_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"has no bundle1\.tif"):
        look_at(tmp_path)
