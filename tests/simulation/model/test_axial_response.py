from __future__ import annotations

import numpy as np
import pytest

from napari_elsplus.errors import InputError
from napari_elsplus.simulation.model.axial_response import (
    LINE_MODELS,
    LineModel,
    gaussian_over_slit,
    line_response,
    model_drop_offs,
    model_response,
    signal_kept,
)

LINE = LINE_MODELS["a"]


@pytest.mark.parametrize("spread", [0.2, 0.3])
def test_gaussian_line_through_a_thin_slit_drops_where_algebra_says(spread: float) -> None:
    line = LineModel(core_um=5.0, halo_share=0.0, halo_um=30.0, spread=spread, gap_um=0.0)
    drops = model_drop_offs(offset_um=None, slit_um=0.0, line=line)
    assert drops == pytest.approx((np.sqrt(3) * 5 / spread, np.sqrt(99) * 5 / spread), rel=1e-9)


def test_light_is_only_moved_so_its_sum_over_offsets_does_not_change_with_depth() -> None:
    offsets_um = np.arange(-20_000, 20_000, 1.0)
    sums = [line_response(depth, offsets_um, 2.9, LINE).sum() for depth in (0, 30, 300, 3000)]
    assert sums == pytest.approx([1] * 4, rel=1e-6)


def test_far_field_falls_as_first_and_third_power() -> None:
    far = model_response(np.array([1e4, 1e5]), offset_um=29.0)
    slope = np.diff([np.log10(far.ls), np.log10(far.els)])[:, 0]
    assert slope == pytest.approx([-1, -3], abs=0.01)


def test_no_offset_leaves_nothing_and_an_endless_one_leaves_all() -> None:
    depth_um = np.arange(0.0, 500, 10)
    assert (model_response(depth_um, offset_um=0.0).els == 0).all()
    endless = model_response(depth_um, offset_um=1e5)
    assert np.array_equal(endless.els, endless.ls)
    with pytest.raises(InputError, match="offset is 0 um"):
        model_drop_offs(offset_um=0.0)


def test_sign_of_the_offset_does_not_matter_without_an_edge() -> None:
    depth_um = np.arange(0.0, 500, 10)
    assert model_response(depth_um, offset_um=-29.0).els == pytest.approx(model_response(depth_um, offset_um=29.0).els)


def test_slit_mean_is_the_integral() -> None:
    y = np.linspace(20 - 4, 20 + 4, 200_001)
    mean = np.trapezoid(np.exp(-0.5 * (y / 7) ** 2) / (np.sqrt(2 * np.pi) * 7), y) / 8
    assert gaussian_over_slit(20.0, 8.0, 7.0) == pytest.approx(mean, rel=1e-9)


def test_a_narrow_slit_is_averaged_over_as_a_wide_one() -> None:
    offset_um = np.linspace(0, 20, 41)
    just_narrow, just_wide = (gaussian_over_slit(offset_um, share * 7.0, 7.0) for share in (0.19999, 0.20001))
    np.testing.assert_allclose(just_narrow, just_wide, atol=1e-5 / 7)


@pytest.mark.parametrize(
    ("offset_um", "drop_3db_um", "drop_10db_um", "tolerance"),
    [
        (12, 18.5, 52.7, 0.15),
        (29, 35.1, 118.9, 0.05),
        (40, 41.9, 157, 0.05),
        (58, 48.9, 212, 0.05),
        (77, 53.1, 262, 0.1),
    ],
)
def test_drop_offs_of_the_paper(offset_um: float, drop_3db_um: float, drop_10db_um: float, tolerance: float) -> None:
    assert model_drop_offs(offset_um=offset_um) == pytest.approx((drop_3db_um, drop_10db_um), rel=tolerance)


def test_slit_width_hardly_moves_els_and_signal_is_kept() -> None:
    drops_10db_um = [model_drop_offs(offset_um=29, slit_um=slit).drop_10db_um for slit in (1.9, 2.9, 5.8)]
    assert drops_10db_um == pytest.approx([120] * 3, rel=0.05)
    kept = [signal_kept(offset_um=offset) for offset in (12, 20, 29, 40, 58, 77)]
    assert kept == pytest.approx([0.63, 0.78, 0.82, 0.86, 0.92, 0.967], abs=0.01)
    assert kept[-1] > 0.95  # the paper: virtually no price at 77 um


def test_sharper_line_of_the_slit_panels() -> None:
    """Fits printed under panels (c, d) of the drop-off figure, over the slits measured."""
    sharp = LINE_MODELS["b"]
    slits_um = np.array([2.9, 5.8, 8.6, 11.5])
    ls_3db = 0.065 * slits_um**2 + 0.084 * slits_um + 26
    els_10db = 0.034 * slits_um**2 + 2.6 * slits_um + 170
    model = [
        (
            model_drop_offs(offset_um=None, slit_um=slit, line=sharp)[0],
            model_drop_offs(offset_um=77, slit_um=slit, line=sharp)[1],
        )
        for slit in slits_um
    ]
    off = np.array(model) / np.stack([ls_3db, els_10db], 1) - 1
    assert np.sqrt((off**2).mean()) < 0.1


@pytest.mark.parametrize("bad", [{"core_um": 0.0}, {"spread": float("nan")}, {"halo_share": 1.2}, {"halo_um": 4.0}])
def test_impossible_lines_are_refused(bad: dict[str, float]) -> None:
    numbers = {"core_um": 5.0, "halo_share": 0.5, "halo_um": 30.0, "spread": 0.2, "gap_um": 0.0} | bad
    with pytest.raises(InputError, match=str(next(iter(bad.values())))):
        LineModel(**numbers)
