from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from napari_elsplus.errors import InputError
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.processing.mosaicing.mosaic import Insertion
from napari_elsplus.processing.tracking.registry import Method
from napari_elsplus.viewing.mosaic.recorded import StackMosaics
from napari_elsplus.workflows.mosaic_plan import MosaicPlan
from napari_elsplus.workflows.sectioning import RawPairs
from napari_elsplus.workflows.tracking import Pipeline, calibration_of_finished_images
from recordings import Truth, record, smooth_path, texture

FRAMES = 24
ALL = (Mode.LS, Mode.ELSA, Mode.ELS)


@cache
def truth() -> Truth:
    return record(texture(700, 3), smooth_path(FRAMES, 9.0, 700, 4))


def test_every_mode_lies_along_the_track_of_one() -> None:
    recording = truth()
    mosaics = StackMosaics(recording.frames, recording.calibration, MosaicPlan(ALL))
    seen: dict[str, list[int]] = {}

    def watch(steps, name):
        for step in steps:
            yield step
            seen.setdefault(name, []).append(len(mosaics.rows))
            assert set(mosaics.canvases) == set(ALL)

    mosaics.run(watch)
    assert seen["Tracking"] == list(range(1, FRAMES + 1))
    assert len(seen["Mosaic"]) <= 2 * FRAMES
    alone = Pipeline(recording.calibration, recording.frames.shape[1:], Mode.ELS)
    pairs = RawPairs(recording.frames, Mode.ELS)
    for k in range(FRAMES):
        alone.track(recording.frames[k], k)
    alone.finish(pairs)
    assert [row.row_px for row in mosaics.rows] == [row.row_px for row in alone.rows]
    images = {mode: canvases[0].read()[0] for mode, canvases in mosaics.canvases.items()}
    np.testing.assert_array_equal(images[Mode.ELS], alone.mosaics[0].read()[0])
    assert images[Mode.LS].shape == images[Mode.ELS].shape
    assert images[Mode.LS].mean() > images[Mode.ELS].mean() + 5  # the haze that sectioning takes away
    assert mosaics.scale.um_per_px == pytest.approx(2.3 * mosaics.scale.camera_px_per_pixel)


def test_what_is_ended_early_stays() -> None:
    recording = truth()
    mosaics = StackMosaics(recording.frames, recording.calibration, MosaicPlan((Mode.LS,)))

    class Ended(Exception):
        pass

    def watch(steps, name):
        for step in steps:
            if step == 9:
                raise Ended
            yield step

    with pytest.raises(Ended):
        mosaics.run(watch)
    assert len(mosaics.rows) == 9
    assert mosaics.canvases[Mode.LS][0].extent is not None


def test_undoing_takes_the_last_segment_and_calls_its_frames_lost() -> None:
    recording = truth()
    frames = recording.frames.copy()
    frames[8:16] = 4  # the probe is lifted
    mosaics = StackMosaics(np.concatenate([frames[:16], frames[19:]]), recording.calibration, MosaicPlan())
    mosaics.run()
    segments = set(mosaics.canvases[Mode.ELS])
    revision = mosaics.revision
    last = max(segments)
    assert mosaics.undo()
    assert mosaics.revision != revision
    assert set(mosaics.canvases[Mode.ELS]) == segments - {last}
    assert {row.state for row in mosaics.rows if row.segment == last} == {"lost"}
    while mosaics.undo():
        pass
    assert all(row.state == "lost" and np.isnan(row.row_px) for row in mosaics.rows)


@pytest.mark.parametrize(
    ("frames", "words"),
    [
        (np.zeros((1, 236, 480), np.uint8), "1 frame:"),
        (np.full((5, 236, 480), 9, np.uint8), "constant .grey level 9."),
        (np.full((5, 236, 480), 255, np.uint8), "constant .*: 100.0 % of the pixels are saturated: lower the laser"),
        (np.full((5, 236, 480), np.nan, np.float32), "NaN"),
        (np.zeros((5, 236, 480, 3), np.uint8), "grey levels"),
    ],
)
def test_what_makes_no_mosaic_is_refused_in_words(frames: np.ndarray, words: str) -> None:
    with pytest.raises(InputError, match=words):
        StackMosaics(frames, truth().calibration, MosaicPlan())


def test_no_mode_is_refused() -> None:
    with pytest.raises(InputError, match="no image is chosen"):
        StackMosaics(truth().frames, truth().calibration, MosaicPlan(()))


def test_frames_of_noise_are_told_not_guessed() -> None:
    frames = np.random.default_rng(0).integers(0, 200, (6, 236, 480), np.uint8)
    mosaics = StackMosaics(frames, truth().calibration, MosaicPlan())
    mosaics.run()
    assert any("no two frames" in note for note in mosaics.notes)


@pytest.mark.parametrize("method", list(Method))
def test_finished_images_are_tracked_as_they_are(method: Method) -> None:
    scene = 100 * texture(700, 3)
    places = [(200 + 4 * k, 250 + 7 * k) for k in range(12)]
    images = np.stack([scene[row : row + 240, col : col + 240] for row, col in places])
    plan = MosaicPlan((Mode.LS,), method, Insertion.FEATHERED)
    mosaics = StackMosaics(images, calibration_of_finished_images(images, 2.0), plan, finished=True)
    mosaics.run()
    found = np.array([(row.row_px, row.col_px) for row in mosaics.rows])
    np.testing.assert_allclose(found, np.subtract(places, places[0]), atol=0.1 if method is Method.ELSPLUS else 6)
