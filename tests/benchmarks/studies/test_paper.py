from __future__ import annotations

from dataclasses import replace

import pytest

from benchmarks.studies import paper
from napari_elsplus.processing.analysis.image_quality import PAPER_ALIGNMENT_PERCENT
from napari_elsplus.processing.images.cores import CoreFilter
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.processing.tracking.registry import Method
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.specimen.trajectories import HandHeld, Straight


def test_a_calibration_from_frames_finds_the_instrument() -> None:
    found = paper.calibrate_simulated(Instrument.of("240hz"), steps=20)
    assert abs(found.errors.offset_rows) < 0.05
    assert abs(found.errors.galvo_slope_percent) < 0.1
    assert found.errors.pair_alignment_px < 0.05


def test_centres_alone_leave_the_papers_alignment_error_which_no_median_removes() -> None:
    instrument = replace(Instrument.of("120hz"), residual_view=paper.PAPER_LIKE)
    errors = paper.errors_by_centres(instrument)
    papers, papers_filtered = PAPER_ALIGNMENT_PERCENT
    assert 100 * errors.before == pytest.approx(papers, rel=0.1)
    assert 100 * errors.filtered[CoreFilter.MEDIAN] > 4 * papers_filtered


@pytest.fixture(scope="module")
def slow_frames() -> paper.MovingFrames:
    return paper.moving_frames("240hz", 10.0, "fibres", HandHeld(200.0, tremor_um=2.0, seed=2), 2)


def test_els_is_nearer_to_the_focal_plane_than_ls_and_than_elsa_of_a_moving_probe(
    slow_frames: paper.MovingFrames,
) -> None:
    found = paper.sectioned(slow_frames, (Mode.LS, Mode.ELSA, Mode.ELS))
    unexplained = {mode: one.unexplained for mode, one in found.items()}
    assert unexplained[Mode.ELS] < 0.9 * min(unexplained[Mode.LS], unexplained[Mode.ELSA])
    assert found[Mode.ELS].background < 0.5 * found[Mode.LS].background


def test_our_track_ends_nearer_to_the_truth_than_the_papers() -> None:
    frames = paper.moving_frames("240hz", None, "fibres", Straight(6000.0), 8)
    ours = paper.mosaic(frames, Mode.ELS, live=True)
    papers = paper.mosaic(frames, Mode.ELS, Method.PAPER, live=True)
    assert ours.errors.tracked == papers.errors.tracked == 8
    assert ours.errors.end_error_percent_of_path < 0.5 < papers.errors.end_error_percent_of_path
    assert min(ours.image.shape) > 230  # a frame's field of 209 pixels, and what the probe went
