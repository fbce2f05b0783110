"""Checks as the paper makes them: alignment, resolution, rim; the script says the same."""

from __future__ import annotations

import numpy as np
import pytest
import tifffile
from scipy.ndimage import gaussian_filter

from benchmarks.rigs.random_rigs import Rig
from napari_elsplus.errors import InputError, MeasurementError
from napari_elsplus.io import open_recording, write_calibration
from napari_elsplus.processing.calibration.calibrate import measure
from napari_elsplus.processing.calibration.draft import setup_of
from napari_elsplus.processing.calibration.steps import find_step
from napari_elsplus.viewing.lazy import LazyPlanes
from napari_elsplus.viewing.quality import measure_alignment, measure_edge, measure_resolution, quality_script
from napari_elsplus.viewing.stack import Stack
from pairs import DIAMETER, SHAPE, calibration

UM_PER_PX = 1.0
CENTRES = (32, 31), (30, 95)
ELEMENTS = {(5, 3): 12.4, (6, 1): 7.8, (6, 5): 4.9}
"""Group and element, and the width of a bar in pixels."""


def stack_of(frames):
    return Stack("scan", LazyPlanes(frames.__getitem__, frames.shape, frames.dtype))


def lit(left=100.0, right=100.0, seed=None, around=0.0):
    """A frame lit from the far end, with a honeycomb of its own in each view if a seed is given."""
    frame = np.zeros(SHAPE, np.uint8)
    noise = np.zeros(SHAPE) if seed is None else np.random.default_rng(seed).normal(0, 10, SHAPE)
    frame[:, : SHAPE[1] // 2], frame[:, SHAPE[1] // 2 :] = left, right
    rows, cols = np.ogrid[: SHAPE[0], : SHAPE[1]]
    away = [np.hypot(rows - row, cols - col) for row, col in CENTRES]
    return np.where(np.minimum(*away) < 1.06 * DIAMETER / 2, np.round(frame + noise), around * frame).astype(np.uint8)


def target():
    """A picture of the elements, and a box around each."""
    picture, boxes, top = np.full((170, 90), 10.0), [], 4.0
    for width in ELEMENTS.values():
        for bar in range(3):
            left = 5 + 2 * bar * width
            picture[round(top) : round(top + 5 * width), round(left) : round(left + width)] = 100
        boxes.append((top, 5.0, top + 5 * width, 5 + 5 * width))
        top += 5 * width + 8
    return picture, boxes


def test_views_that_differ_by_a_tenth_are_misaligned_by_a_tenth_and_a_filter_calms_noise():
    found = measure_alignment(stack_of(lit(100, 90)[None]), calibration(), 0)
    assert found.before == pytest.approx(0.1, abs=1e-3)
    noisy = measure_alignment(stack_of(lit(seed=1)[None]), calibration(), 0)
    assert noisy.after < 0.6 * noisy.before
    with pytest.raises(MeasurementError, match="dark"):
        measure_alignment(stack_of(lit(0, 0)[None]), calibration(), 0)


@pytest.mark.parametrize("turned", [False, True])
def test_elements_are_named_and_blur_takes_the_finest_first(turned):
    picture, boxes = target()
    if turned:
        picture, boxes = picture.T, [(left, top, right, bottom) for top, left, bottom, right in boxes]
    sharp = measure_resolution(picture, boxes, UM_PER_PX)
    assert [(one.group, one.element) for one in sharp.elements] == list(ELEMENTS)
    assert all(one.resolved for one in sharp.elements)
    assert sharp.finest_um == pytest.approx(1000 / 2 ** (6 + 4 / 6))
    finest = [measure_resolution(gaussian_filter(picture, sigma), boxes, UM_PER_PX).finest_um for sigma in (3.5, 6)]
    assert finest == [pytest.approx(1000 / 2**6), pytest.approx(1000 / 2 ** (5 + 2 / 6))]
    assert np.isnan(measure_resolution(np.full_like(picture, 9), boxes, UM_PER_PX).finest_um)


def test_boxes_without_bars_are_refused():
    picture, _ = target()
    with pytest.raises(InputError, match="no bars"):
        measure_resolution(picture, [(3, 3, 6, 60)], UM_PER_PX)
    with pytest.raises(InputError, match="0 elements"):
        measure_resolution(picture, [], UM_PER_PX)


def test_the_edge_map_shows_where_the_residual_is_short():
    frames = np.stack([lit(around=1.0) for _ in range(3)])
    frames[:, :16, SHAPE[1] // 2 :] //= 2
    seen = []
    found = measure_edge(stack_of(frames), calibration(), lambda indices: (seen.append(k) or k for k in indices))
    assert seen == [0, 1, 2]
    assert found.frames == 3
    rows = found.position_um / 2.0 + 30  # of the right view, whose centre is at row 30
    whole, half = found.profile[rows > 20], found.profile[rows < 11]
    np.testing.assert_allclose(whole, whole[-1], rtol=0.01)  # the interpolation rings a little at the step
    np.testing.assert_allclose(half, whole[-1] / 2, rtol=0.01)


def test_the_script_runs_and_says_the_same(tmp_path, capsys):
    tifffile.imwrite(tmp_path / "scan.tif", lit(100, 90, seed=2)[None], photometric="minisblack")
    beside = write_calibration(tmp_path / "scan.calibration.json", calibration())
    with open_recording(tmp_path / "scan.tif") as recording:
        stack = Stack.of(recording)
        found = measure_alignment(stack, calibration(), 0)
        script = quality_script(stack, beside, "median", 0, [(10.0, 10.0, 30.0, 30.0)])
    exec(script, {})
    said = capsys.readouterr().out
    assert f"alignment error: {found.text}" in said
    assert "smallest resolved line pair: nan um" in said


def test_quality_and_calibration_measure_the_same_alignment_error():
    frames = Rig(left=(112.0, 103.0), right=(98.4, 318.7), diameter_px=190.0, gain=0.93).bundle(1)
    draft = measure(bundle=frames)
    errors = measure_alignment(stack_of(frames), draft.calibration, 0)
    quality = draft.calibration.quality
    assert quality.core_filter == errors.cores == "gaussian"
    assert (quality.alignment_error, quality.alignment_error_filtered) == (errors.before, errors.after)
    assert "after the Gaussian filter (0.4 core pitches)" in errors.text
    assert "after the 3x3 median filter" in errors.text
    lines = "\n".join(find_step("pair").summary(draft, draft.pair, setup_of(frames)).lines)
    assert errors.text in lines
    assert "Thrapp 2021, USAF target in transmission: 5.5 % unfiltered, 0.74 % after its core filter" in lines
