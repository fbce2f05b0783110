from __future__ import annotations

import warnings
from types import SimpleNamespace
from typing import TYPE_CHECKING

import numpy as np
import pytest
import tifffile

from napari_elsplus.errors import InputError
from napari_elsplus.instrument.calibration import OffsetSection
from napari_elsplus.io import read_track
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.processing.mosaicing.line_light import LineLight
from napari_elsplus.viewing.mosaic.recorded import StackMosaics
from napari_elsplus.workflows import tracking
from napari_elsplus.workflows.mosaic_plan import MosaicPlan
from napari_elsplus.workflows.mosaicing import MosaicResult, mosaic, track
from napari_elsplus.workflows.simulated import simulate_recording
from napari_elsplus.workflows.tracked_stack import TrackedStack
from recordings import Truth, fibres, record, smooth_path, texture

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.front_end.grid import Grid


@pytest.fixture(scope="module")
def truth() -> Truth:
    return record(fibres(1000, 200, 1), smooth_path(12, 25.0, 1000, 1))


@pytest.fixture(scope="module")
def result(truth: Truth) -> MosaicResult:
    return mosaic(truth.frames, truth.calibration, "els", times_s=own_times_s(truth, 1.0))


def test_the_track_is_that_of_the_mosaic(truth: Truth, result: MosaicResult) -> None:
    times_s = own_times_s(truth, 1.0)
    alone = track(truth.frames, truth.calibration, "els", times_s=times_s)
    assert repr(alone) == repr(result.track)  # NaN equals itself in words only
    assert [row.time_s for row in alone] == times_s.tolist()
    found = np.array([(row.row_px, row.col_px) for row in alone])
    assert np.abs(found - (truth.positions - truth.positions[0])).max() < 0.5


def own_times_s(truth: Truth, stretch: float) -> NDArray[np.float64]:
    """Times of frames that were taken at the calibration's rate, or a slower one."""
    period_s = truth.calibration.frame_period_s
    assert period_s is not None
    return stretch * period_s * np.arange(len(truth.frames))


@pytest.mark.parametrize(("stretch", "noted"), [(1.0, 0), (1.01, 0), (1.1, 1), (0.5, 1)])
def test_frames_of_another_rate_than_the_calibration_are_noted(truth: Truth, stretch: float, noted: int) -> None:
    times_s = own_times_s(truth, stretch)
    found = mosaic(truth.frames, truth.calibration, "els", times_s=times_s)
    mosaics = StackMosaics(truth.frames, truth.calibration, MosaicPlan((Mode.ELS,)), times_s)
    mosaics.run()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        track(truth.frames, truth.calibration, "els", times_s=times_s)
    for notes in (found.notes, mosaics.notes, [str(warning.message) for warning in caught]):
        assert [f"{1.912 * stretch:.2f} ms apart" in note and "\n" not in note for note in notes] == [True] * noted


def test_each_step_reports_its_progress(truth: Truth) -> None:
    steps: dict[str, int] = {}

    def progress(numbers: Iterable[int], step: str, /) -> Iterable[int]:
        steps[step] = len(list(numbers))
        return numbers

    mosaic(truth.frames, truth.calibration, "els", progress=progress)
    second = {"Tracking again, without what stands still": 12}  # of a dozen frames the median contains the tissue
    assert steps == {"Tracking": 12, **second, "Mosaic": 12}
    steps.clear()
    track(truth.frames, truth.calibration, "els", progress=progress)
    assert steps == {"Tracking": 12, **second}


def test_a_result_is_saved_whole_or_not_at_all(result: MosaicResult, tmp_path: Path) -> None:
    (tmp_path / "track.csv").write_text("mine")
    with pytest.raises(InputError, match=r"track\.csv exists"):
        result.save(tmp_path / "mosaic.ome.tif", tmp_path / "track.csv")
    assert [path.name for path in tmp_path.iterdir()] == ["track.csv"]
    result.save(tmp_path / "mosaic.ome.tif", tmp_path / "track.csv", force=True)
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "mosaic.ome.tif"), result.image)
    assert [row.state for row in read_track(tmp_path / "track.csv")] == ["tracked"] * 12


def test_two_frames_that_do_not_overlap_are_noted(truth: Truth) -> None:
    noise = np.random.default_rng(0).integers(0, 255, (2, *truth.frames.shape[1:])).astype(np.uint8)
    found = mosaic(noise, truth.calibration, "els")
    assert found.segments <= 1
    assert len(found.notes) == (sum(row.state == "tracked" for row in found.track) < 2)


def test_finished_images_of_floats_are_tracked_as_they_are() -> None:
    scene = fibres(600, 200, 4) - 0.5
    places = np.array([(80 + 5 * k, 100 + 8 * k) for k in range(6)])
    images = [scene[row : row + 180, col : col + 160].astype(np.float32) for row, col in places]
    images[4][:, :3] = np.nan
    found = mosaic(images, finished=True)
    positions = np.array([(row.row_px, row.col_px) for row in found.track])
    np.testing.assert_allclose(positions, places - places[0], atol=0.25)
    assert (found.calibration, found.um_per_px, found.settings["mode"]) == (None, None, "finished")
    assert repr(track(images, finished=True)) == repr(found.track)


def test_finished_images_exclude_a_calibration_and_a_mode(truth: Truth) -> None:
    with pytest.raises(InputError, match="finished images have no calibration"):
        mosaic(truth.frames, truth.calibration, finished=True)
    with pytest.raises(InputError, match="finished images have no mode"):
        track(truth.frames, mode="ls", finished=True)
    with pytest.raises(InputError, match="raw frames need a calibration"):
        mosaic(truth.frames)


@pytest.mark.parametrize("haze_left_over", [0.3, 0.6])
def test_haze_beyond_the_line_is_neither_tracked_nor_taken_for_uneven_light(haze_left_over: float) -> None:
    """No residual is seen there, and the haze stands still.

    4 of 13 frames were tracked, or 11; and the light seemed to vary by 74 or by 12 %, and was taken out.
    """
    along = np.linspace(0, 110, 13)
    truth = record(
        0.15 * texture(700, 3, 3.0), np.stack([230 + 0.8 * along, 230 + along], axis=1),
        shape=(270, 480), left=(135.3, 116.6), right=(111.1, 355.2), haze=1.0, haze_left_over=haze_left_over,
    )  # fmt: skip
    rows, cols = np.indices(truth.frames.shape[1:])
    unlit = (np.hypot(rows - 135.3, cols - 355.2) > 105) & (cols > 236)
    offset = OffsetSection(rows=-24.2, uncertainty_rows=0.01)
    result = mosaic(np.where(unlit, 4, truth.frames), truth.calibration.model_copy(update={"offset": offset}))
    assert {row.state for row in result.track} == {"tracked"}
    assert not any("uneven light" in note for note in result.notes)


def test_even_light_is_left_in_a_mosaic_of_elsa() -> None:
    """Before: up to 13 % were taken out of each of four recordings by hand, whose motion edges move with the probe."""
    recording = simulate_recording(path="hand", speed_um_s=1500, frames=80, seed=1)
    assert mosaic(recording, recording.calibration, "elsa").notes == ()


def test_uneven_light_is_taken_out_of_all_image_types(truth: Truth, monkeypatch: pytest.MonkeyPatch) -> None:
    """Before: of the tracked one alone, beside which the others kept their ramps."""
    plan, made = MosaicPlan((Mode.LS, Mode.ELS)), []
    for relative in (1.0, 2.0):

        def estimate(_image: object, _poses: object, grid: Grid, relative: float = relative) -> LineLight:
            light = np.full((grid.side, grid.side), relative, np.float32)
            return LineLight(light, departure=relative - 1, uncertainty=0.0, spread=(relative, relative))

        monkeypatch.setattr(tracking, "estimate_line_light", estimate)
        stack = TrackedStack(truth.frames, truth.calibration, plan)
        stack.run()
        made.append({mode: canvases[0].read()[0] for mode, canvases in stack.canvases.items()})
    for mode in plan.modes:
        np.testing.assert_allclose(2 * made[1][mode], made[0][mode], rtol=1e-5, atol=1e-3)


def test_deformation_is_undone_in_all_image_types(truth: Truth, monkeypatch: pytest.MonkeyPatch) -> None:
    """Before: in the tracked one alone, with which the others did not agree in place."""
    plan, made = MosaicPlan((Mode.LS, Mode.ELS)), []
    for factor in (1, 2):
        found = SimpleNamespace(undone=lambda _index, image, factor=factor: factor * image)
        monkeypatch.setattr(tracking, "estimate_deformation", lambda *_, found=found: found)
        stack = TrackedStack(truth.frames, truth.calibration, plan)
        stack.run()
        made.append({mode: canvases[0].read()[0] for mode, canvases in stack.canvases.items()})
    for mode in plan.modes:
        np.testing.assert_allclose(made[1][mode], 2 * made[0][mode], rtol=1e-5, atol=1e-3)
