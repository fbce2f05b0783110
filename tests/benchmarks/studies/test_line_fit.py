from __future__ import annotations

import pytest

from benchmarks.studies.line_fit import FITTED, fit_line
from napari_elsplus.simulation.model.axial_response import LINE_MODELS


def test_the_line_of_state_a_is_the_best_fit_to_the_paper() -> None:
    fit = fit_line()
    for name in FITTED:
        assert getattr(LINE_MODELS["a"], name) == pytest.approx(getattr(fit.line, name), rel=2e-3)
        assert 0.02 < fit.relative_uncertainty[name] < 0.2
