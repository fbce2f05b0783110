from __future__ import annotations

import numpy as np
import pytest

from benchmarks.studies.resolution import measure_mode, modes, target
from napari_elsplus.processing.analysis.resolution import BarElement, element_contrast, nearest_usaf_1951
from napari_elsplus.processing.images.cores import CoreFilter

STEP_UM = 0.25


def test_bars_are_those_of_the_standard_and_lie_where_they_are_located() -> None:
    scene, elements = target()
    axis_um = np.arange(-200, 200, STEP_UM) + STEP_UM / 2
    picture = scene.planes[0].texture.sample(axis_um, axis_um)
    assert picture.max() == 1  # no two overlap
    for ways in elements:
        for way in ways:
            assert nearest_usaf_1951(way.line_pair_um)[2] == pytest.approx(way.line_pair_um)
            in_px = [tuple((edge + 200) / STEP_UM for edge in bar) for bar in way.bars_px]
            assert element_contrast(picture, BarElement(way.line_pair_um, tuple(in_px))) > 0.99  # type: ignore[arg-type]


def test_the_cropped_mode_keeps_the_magnification_and_fits_the_fast_region() -> None:
    fast, cropped = modes()["240 Hz"], modes()["240 Hz, 10x, cropped"]
    assert cropped.frame_shape == fast.frame_shape
    assert cropped.optics.frame_rate_hz == pytest.approx(fast.optics.frame_rate_hz)
    assert cropped.optics.um_per_px == modes()["120 Hz"].optics.um_per_px
    assert cropped.offset_um == pytest.approx(fast.offset_um)
    for centre in (cropped.confocal_centre, cropped.residual_centre):
        assert 0 < centre[0] - cropped.diameter_px / 2 < centre[0] + cropped.diameter_px / 2 < fast.frame_shape[0]


def test_a_mode_resolves_no_line_pair_below_its_sampling_and_a_median_costs_resolution() -> None:
    mode = modes()["240 Hz, under-sampled"]
    found = measure_mode(mode, places=3, seed=7)
    assert found.px_per_core == pytest.approx(1.2)
    unfiltered, median = found.line_pair_um[CoreFilter.NONE], found.line_pair_um[CoreFilter.MEDIAN]
    assert 2 * mode.optics.um_per_px < unfiltered < median
