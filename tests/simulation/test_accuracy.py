from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from napari_elsplus.io import TrackPoint
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.simulation.accuracy import calibration_errors, correlation_with_focal_plane, track_errors
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.rendering.renderer import Renderer
from napari_elsplus.simulation.specimen.scenes import scene
from napari_elsplus.simulation.truth import true_calibration

INSTRUMENT = Instrument.of("240hz")


def test_a_perfect_calibration_has_no_errors() -> None:
    errors = calibration_errors(true_calibration(INSTRUMENT), INSTRUMENT)
    assert errors.pair_alignment_px == pytest.approx(0, abs=1e-9)
    assert errors.offset_rows == errors.galvo_slope_percent == errors.galvo_intercept_rows == errors.centre_px == 0


def test_errors_are_measured_minus_true() -> None:
    other = replace(INSTRUMENT, offset_rows=INSTRUMENT.offset_rows + 0.5, volts_per_row=INSTRUMENT.volts_per_row * 1.01)
    errors = calibration_errors(true_calibration(other), INSTRUMENT)
    assert errors.offset_rows == pytest.approx(0.5)
    assert errors.galvo_slope_percent == pytest.approx(1)


def test_els_shows_the_focal_plane_better_than_ls() -> None:
    whole = scene("fibres")
    raw = Renderer(INSTRUMENT, whole).render(0)
    in_focus = Renderer(INSTRUMENT, whole.in_focus(), noise=False).render(0)
    calibration = true_calibration(INSTRUMENT)
    ls, els = (correlation_with_focal_plane(raw, in_focus, calibration, mode) for mode in (Mode.LS, Mode.ELS))
    assert ls < els < 1
    assert correlation_with_focal_plane(in_focus, in_focus, calibration, Mode.LS) == pytest.approx(1)


def row(frame: int, segment: int, col_px: float, state: str = "tracked") -> TrackPoint:
    return TrackPoint(frame, 0.0, segment, 0.0, col_px, 0.0, 0.0, 1.0, 0.1, state)


def test_links_across_segments_and_lost_frames_do_not_count() -> None:
    true_px = np.array([(0.0, 10.0 * k) for k in range(7)])
    rows = [
        row(0, 0, 0),
        row(1, 0, 10.2),
        row(2, 0, 20.2),
        row(3, 0, np.nan, "lost"),
        row(4, 1, 0),
        row(5, 1, 14),
        row(6, 1, 24),
    ]
    errors = track_errors(rows, true_px)
    assert (errors.frames, errors.tracked, errors.segments, errors.wrong_links) == (7, 6, 2, 1)
    assert errors.median_pair_error_px == pytest.approx(0.1)
    assert errors.end_error_percent_of_path == pytest.approx(100 * (0.2 + 4) / 40)
    assert errors.path_px == 60


def test_a_track_without_links_has_no_error_to_tell() -> None:
    errors = track_errors([row(0, 0, 0), row(1, 0, np.nan, "lost")], np.zeros((2, 2)))
    assert np.isnan(errors.median_pair_error_px)
    assert np.isnan(errors.end_error_percent_of_path)
