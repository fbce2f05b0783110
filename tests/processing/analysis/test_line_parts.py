"""Core and halo of the laser line: stated where both are significant, and only there."""

from __future__ import annotations

import numpy as np
import pytest

from napari_elsplus.errors import MeasurementError
from napari_elsplus.processing.analysis.line_parts import LineParts, measure_line_parts

ROW, CORE_ROWS = 130.0, 1.2


def parts(halo: float, halo_rows: float, seed: int) -> LineParts:
    """Fit a line of 80 grey levels on a halo of a peak in grey levels, through cores that differ by 15 %."""
    random = np.random.default_rng(seed)
    y, x = np.mgrid[:260, :260]
    light = 80 * np.exp(-((y - ROW) ** 2) / (2 * CORE_ROWS**2)) + halo * np.exp(-((y - ROW) ** 2) / (2 * halo_rows**2))
    light *= (abs(x - 130) < 115) * random.normal(1, 0.15, y.shape)
    return measure_line_parts(light + random.normal(0, 0.3, y.shape), ROW, 0.0, (15, 246), CORE_ROWS)


@pytest.mark.parametrize("seed", range(3))
def test_a_halo_is_measured_within_its_uncertainty(seed: int) -> None:
    found = parts(4.0, 15.0, seed)
    assert abs(found.core_rows - CORE_ROWS) < 4 * found.core_uncertainty_rows + 0.01
    assert abs(found.halo_rows - 15.0) < 4 * found.halo_uncertainty_rows
    assert abs(found.halo_share - 60 / 156) < 4 * found.halo_share_uncertainty


@pytest.mark.parametrize(("halo", "halo_rows", "seed"), [(0.5, 150, 3), (0.5, 400, 3), (2.0, 400, 1), (2.0, 400, 3)])
def test_no_halo_is_stated_where_core_or_halo_is_not_significant(halo: float, halo_rows: float, seed: int) -> None:
    """Unequal light beside the line was stated as a halo of 92 % with an uncertainty of 1200 %, or of NaN."""
    with pytest.raises(MeasurementError, match="no halo"):
        parts(halo, halo_rows, seed)


@pytest.mark.parametrize(("halo", "halo_rows", "seed"), [(0.0, 10.0, 39), (1.0, 60.0, 4)])
def test_a_small_view_without_a_halo_is_refused_where_the_fit_diverges(
    halo: float, halo_rows: float, seed: int
) -> None:
    """Its halo's width overflowed."""
    random = np.random.default_rng(seed)
    y, x = np.mgrid[:120, :120] - 60.0
    light = 80 * np.exp(-(y**2) / (2 * 0.6**2)) + halo * np.exp(-(y**2) / (2 * halo_rows**2))
    light *= (abs(x) < 52.8) * random.normal(1, 0.15, y.shape)
    with pytest.raises(MeasurementError, match="no halo"):
        measure_line_parts(light + random.normal(0, 0.3, y.shape), 60.0, 0.0, (7, 112), 0.6)
