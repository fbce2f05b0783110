"""Dependence on the slit offset: the paper's saturation curve, and the best contrast to noise."""

from __future__ import annotations

import numpy as np
import pytest

from napari_elsplus.errors import MeasurementError
from napari_elsplus.processing.analysis.slit_offset import contrast_to_noise, fit_saturation


def test_contrast_to_noise_has_a_best_offset_only_through_noise() -> None:
    assert contrast_to_noise(400, 0, 0) == pytest.approx(20)
    assert contrast_to_noise(400, 100, 0) == pytest.approx(300 / np.sqrt(500))
    assert contrast_to_noise(400, 100, 50) < contrast_to_noise(400, 100, 0)


def test_saturation_fit_raises_when_nothing_saturates() -> None:
    offset = np.array([12.0, 29, 40, 58, 77])
    fit = fit_saturation(offset, [16.9, 35, 41.8, 48.4, 53])
    assert fit.limit_um == pytest.approx(58, abs=5)
    assert fit.rate_per_um == pytest.approx(0.032, rel=0.15)
    with pytest.raises(MeasurementError, match="do not saturate"):
        fit_saturation(offset, np.full(5, np.nan))
