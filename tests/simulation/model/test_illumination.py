"""Vignetting by the rim: the halo that was computed for other line positions is that of the present ones."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import erf

from napari_elsplus.simulation.model import illumination
from napari_elsplus.simulation.model.illumination import Vignetting
from napari_elsplus.simulation.model.instrument import Instrument


def new_edge() -> Vignetting:
    instrument = Instrument.of("240hz")
    return Vignetting(instrument.bundle.radius_um, instrument.line, instrument.slit_um)


def integrated(vignetting: Vignetting, offsets_um: np.ndarray, depth_um: float, row: int, col: int) -> float:
    """Halo collected at a point of the grid, by sums over the rows on which it enters and the cells that it leaves."""
    line, grid, step = vignetting._line, vignetting.grid_um, vignetting.grid_um[1] - vignetting.grid_um[0]
    inner_um, spread_um = np.sqrt(line.halo_um**2 - line.core_um**2), line.spread * depth_um
    edges = np.append(grid - step / 2, grid[-1] + step / 2)
    entered = np.linspace(-5, 5, 401) * vignetting._core_um
    weights = np.exp(-0.5 * (entered / vignetting._core_um) ** 2)
    total = 0.0
    for y, weight in zip(grid[row] + offsets_um[row] + entered, weights / weights.sum(), strict=True):
        if abs(y) >= vignetting.radius_um:
            continue
        half = np.sqrt(vignetting.radius_um**2 - y**2)
        lit = np.clip((half - np.abs(grid)) / step + 0.5, 0, 1)
        leaves = np.exp(-0.5 * ((grid - y) / inner_um) ** 2) / (np.sqrt(2 * np.pi) * inner_um)
        shares = [0.5 * np.diff(erf((edges - grid[at]) / (np.sqrt(2) * spread_um))) for at in (row, col)]
        total += weight * float((leaves * shares[0]) @ vignetting._disc @ (lit * shares[1]))
    sigma_um = np.hypot(vignetting._halo_um, spread_um)
    return total / float(np.exp(-0.5 * (offsets_um[row] / sigma_um) ** 2) / (np.sqrt(2 * np.pi) * sigma_um))


@pytest.mark.parametrize("depth_um", [40.0, 150.0])
@pytest.mark.parametrize("case", ["scanning", "standing"])
def test_the_halo_that_is_collected_is_that_of_all_rows_on_which_it_enters(case: str, depth_um: float) -> None:
    vignetting = new_edge()
    offsets_um = np.full_like(vignetting.grid_um, -29.0) if case == "scanning" else 60.0 - vignetting.grid_um
    halo = vignetting.vignette(offsets_um, depth_um)[1]
    for row, col in ((48, 48), (60, 20), (66, 80), (40, 55)):
        assert halo[row, col] == pytest.approx(integrated(vignetting, offsets_um, depth_um, row, col), abs=2e-3)


def test_what_is_kept_does_not_depend_on_the_lines_before(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(illumination, "_KEPT_DEPTHS", 2)
    used = new_edge()
    for depth_um in (40.0, 93.0, 150.0, 40.0):  # more depths than are kept
        for line_um in (-320.0, -150.0, 7.0, 290.0, 330.0):
            for offsets_um in (line_um - used.grid_um, np.full_like(used.grid_um, line_um / 9)):
                found = used.vignette(offsets_um, depth_um)
                np.testing.assert_array_equal(found, new_edge().vignette(offsets_um, depth_um))


def test_the_halo_of_a_line_beyond_the_bundle_is_dark() -> None:
    vignetting = new_edge()
    beyond_um = vignetting.radius_um + 6 * vignetting._core_um
    assert vignetting.vignette(beyond_um - vignetting.grid_um, 93.0)[1][-3:].max() == 0
    assert vignetting.vignette(vignetting.radius_um - vignetting.grid_um, 93.0)[1][-3:].max() > 0
