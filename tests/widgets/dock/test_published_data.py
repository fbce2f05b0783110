"""From another lab's AVI files to a figure and a mosaic, by mouse and at most four typed numbers."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.screens.walk import SEED, open_dock_in, walk_to_figure, walk_to_mosaic, write_videos
from napari_elsplus.io import read_calibration, read_track
from napari_elsplus.workflows.simulated import simulate_recording

pytestmark = pytest.mark.checkout
FRAMES = 8
MAX_TYPED = 4


def test_from_the_videos_of_another_lab_to_a_figure_and_a_mosaic(make_napari_viewer_proxy, tmp_path):
    write_videos(tmp_path, FRAMES)
    dock = open_dock_in(make_napari_viewer_proxy(show=True))
    hand = walk_to_figure(dock, tmp_path)
    walk_to_mosaic(hand, tmp_path)

    assert hand.typed <= MAX_TYPED
    assert (tmp_path / "comparison.pdf").read_bytes().startswith(b"%PDF")
    found, true = read_calibration(tmp_path / "calibration.json"), simulate_recording(frames=1, seed=SEED).calibration
    assert found.um_per_px == pytest.approx(true.um_per_px, rel=3e-3)
    np.testing.assert_allclose(found.bundle.confocal_centre, true.bundle.confocal_centre, atol=0.3)
    assert found.bundle.residual_gain == pytest.approx(true.bundle.residual_gain, rel=0.01)
    (track,) = tmp_path.glob("*.track.csv")
    assert [point.state for point in read_track(track)] == ["tracked"] * FRAMES
