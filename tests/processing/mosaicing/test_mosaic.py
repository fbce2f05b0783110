from __future__ import annotations

import cv2
import numpy as np
import pytest

from napari_elsplus.processing.mosaicing.montage import montage
from napari_elsplus.processing.mosaicing.mosaic import STILL, Insertion, Mosaic, rim_weights
from napari_elsplus.processing.mosaicing.tiles import TILE_PX, HeapTiles, Rectangle, tile_rectangle
from napari_elsplus.processing.tracking.front_end.front_end import FrontEnd
from napari_elsplus.processing.tracking.front_end.grid import Grid
from napari_elsplus.processing.tracking.motion.pose import Pose, TrackingState
from napari_elsplus.processing.tracking.motion.rolling_shutter import RollingShutter, Velocity
from napari_elsplus.workflows.sectioning import RawPairs
from napari_elsplus.workflows.tracking import Pipeline
from recordings import record, smooth_path, texture

GRID = Grid(120, 1, (0, 0), (59.3, 59.8), 116.0, RollingShutter(150.0))


def wave(row: np.ndarray, col: np.ndarray) -> np.ndarray:
    return 100 + 40 * np.sin(row / 9) * np.cos(col / 7)


def seen(row: float, col: float, velocity: Velocity = Velocity(0.0, 0.0)) -> np.ndarray:  # noqa: B008
    """What a probe at (row, col) that moves while its rows are read makes of the wave."""
    y, x = (np.arange(GRID.side) - c for c in GRID.centre)
    y = y[:, None]
    r = GRID.shutter.line_periods_per_frame
    return wave(row + y + velocity.row * y / r, col + x + velocity.col * y / r).astype(np.float32)


def miss(mosaic: Mosaic) -> float:
    """Largest error of what was drawn."""
    assert mosaic.extent is not None
    image, weight = mosaic.read()
    row, col = np.mgrid[: image.shape[0], : image.shape[1]]
    truth = wave(row + mosaic.extent.top, col + mosaic.extent.left)
    assert (weight > 0).sum() > 5000
    return float(np.abs(image - truth)[weight > 0].max())


@pytest.mark.parametrize("insertion", [how for how in Insertion if how.while_acquiring])
@pytest.mark.parametrize("velocity", [Velocity(0.0, 0.0), Velocity(30.0, -25.0), Velocity(-20.0, 8.0)])
def test_frames_are_unsheared_and_inserted_to_a_fraction_of_a_pixel(insertion: Insertion, velocity: Velocity) -> None:
    mosaic = Mosaic(GRID, insertion)
    for row, col in ((3.4, -7.7), (20.9, 15.2), (-500.0, 700.25)):
        mosaic.insert(seen(row, col, velocity), row, col, velocity)
    assert miss(mosaic) < 0.5
    sheared = Mosaic(GRID, insertion)
    sheared.insert(seen(0.0, 0.0, Velocity(30.0, -25.0)), 0.0, 0.0)
    assert miss(sheared) > 10


def test_a_dead_leaf_covers_what_lay_there_but_its_rim_does_not() -> None:
    mosaic = Mosaic(GRID)
    mosaic.insert(np.full((120, 120), 1.0, np.float32), 0.0, 0.0)
    mosaic.insert(np.full((120, 120), 2.0, np.float32), 0.0, 50.0)
    at = mosaic.extent
    assert at is not None
    image, _ = mosaic.read()
    assert image[-at.top, 50 - at.left] == 2.0
    assert image[-at.top, 0 - at.left] == 1.0  # the rim of the second frame
    assert image[-at.top, 15 - at.left] == 2.0


def test_feathered_frames_are_averaged() -> None:
    """One that is brighter here and darker there, so that the brightness of both is the same."""
    mosaic = Mosaic(GRID, Insertion.FEATHERED)
    checks = np.where(np.indices((120, 120)).sum(axis=0) // 2 % 2, 1.0, 2.0).astype(np.float32)
    for frame in (checks, 3 - checks):
        mosaic.insert(frame, 0.3, 0.3)
    image, weight = mosaic.read()
    assert np.abs(image[weight > 0] - 1.5).max() < 0.02


def test_a_flickering_laser_leaves_no_seams_in_a_feathered_mosaic() -> None:
    exposures = (1.0, 0.75, 1.2, 0.9, 1.3)
    mosaic = Mosaic(GRID, Insertion.FEATHERED)
    for k, factor in enumerate(exposures):
        mosaic.insert(factor * seen(0.0, 25.0 * k), 0.0, 25.0 * k)
    assert miss(mosaic) < 0.1 * 140


def test_brightness_does_not_drift_along_a_noisy_path() -> None:
    rng = np.random.default_rng(0)
    mosaic = Mosaic(GRID, Insertion.FEATHERED)
    for k in range(150):
        frame = 20 + 5 * rng.standard_normal((120, 120)).astype(np.float32)
        mosaic.insert(frame, 0.0, 30.0 * k)
    image, weight = mosaic.read()
    assert abs(image[:, -60:][weight[:, -60:] > 0.2].mean() / 20 - 1) < 0.05


def test_where_the_line_has_left_the_bundle_the_residual_is_missing_and_the_weight_low() -> None:
    """Offset of -20 rows: the line is 20 rows above, so the upper rim is not subtracted; +20: the lower one."""
    upper, lower = rim_weights(GRID, -20.0), rim_weights(GRID, 20.0)
    assert upper[14, 60] < 0.1 < rim_weights(GRID)[14, 60]
    assert upper[104, 60] == rim_weights(GRID)[104, 60]
    assert lower[104, 60] < 0.1 < upper[104, 60]


def test_canvas_grows_in_every_direction_by_the_tiles_that_are_touched() -> None:
    store = HeapTiles()
    mosaic = Mosaic(GRID, store=store)
    for row, col in ((0.0, 0.0), (-20_000.0, 300.0), (300.0, 50_000.0)):
        mosaic.insert(seen(row, col), row, col)
    assert len(store.keys()) <= 12
    part = Rectangle(-20_010, 290, -19_990, 310)
    image, _ = mosaic.read(part)
    truth = wave(*np.mgrid[part.top : part.bottom, part.left : part.right])
    assert np.abs(image - truth).max() < 0.5


def test_only_what_was_touched_is_dirty() -> None:
    mosaic = Mosaic(GRID)
    mosaic.insert(seen(0.0, 0.0), 0.0, 0.0)
    first = mosaic.take_dirty()
    assert first is not None
    assert mosaic.take_dirty() is None
    mosaic.insert(seen(400.0, 0.0), 400.0, 0.0)
    second = mosaic.take_dirty()
    assert second is not None
    assert second.intersection(first).shape[0] == 0
    mosaic.clear()
    assert mosaic.read()[0].size == 0


def test_tiles_cover_the_plane_once() -> None:
    first = tile_rectangle(0, 0)
    keys = list(first.translated(0, -TILE_PX).grown(1).tiles())
    assert sorted(keys) == [(r, c) for r in (-1, 0, 1) for c in (-2, -1, 0)]
    for row, col in keys:
        assert tile_rectangle(row, col) == first.translated(row * TILE_PX, col * TILE_PX)
        assert list(tile_rectangle(row, col).tiles()) == [(row, col)]


def test_a_mosaic_begins_within_one_tile() -> None:
    assert list(Rectangle(-128, -128, 128, 128).tiles()) == [(0, 0)]


def test_mosaic_of_a_fast_recording_is_the_scene() -> None:
    """Correlation with the true scene at least 0.98; frames inserted sheared reach about 0.7."""
    truth = record(texture(1200, 8, 3.0), smooth_path(40, 33.0, 1200, 8))
    pairs = RawPairs(truth.frames, "els")
    found = {}
    for method in ("elsplus", "paper"):
        pipeline = Pipeline(truth.calibration, truth.frames.shape[1:], method=method)
        for index in range(len(pairs)):
            pipeline.track(pairs(index)[0], index)
        pipeline.finish(pairs)
        mosaic = pipeline.mosaics[0]
        at = mosaic.extent
        assert at is not None
        image, weight = mosaic.read()
        row, col = (a * pipeline.camera_px_per_pixel for a in np.mgrid[at.top : at.bottom, at.left : at.right])
        start = truth.positions[0]
        scene = cv2.remap(
            truth.scene, (col + start[1]).astype(np.float32), (row + start[0]).astype(np.float32), cv2.INTER_LINEAR
        )
        smooth = [cv2.GaussianBlur(a, (0, 0), 1.0)[weight > 0] for a in (image, scene)]
        found[method] = np.corrcoef(*smooth)[0, 1]
    assert found["elsplus"] > 0.98
    assert found["paper"] < 0.9


def test_segments_are_shown_below_one_another() -> None:
    small, large = Mosaic(GRID), Mosaic(GRID)
    small.insert(seen(0.0, 0.0), 0.0, 0.0)
    for col in (0.0, 80.0):
        large.insert(seen(0.0, col), 0.0, col)
    image = montage([small, large])
    assert image.shape == (2 * large.read()[0].shape[0] + 16, large.read()[0].shape[1])
    assert (image[: large.read()[0].shape[0]] == large.read()[0]).all()


def test_front_end_allocates_nothing() -> None:
    truth = record(texture(600, 9), np.full((2, 2), 300.0))
    front_end = FrontEnd(truth.calibration, truth.frames.shape[1:])
    out = np.zeros((front_end.grid.side,) * 2, np.float32)
    assert front_end.image(truth.frames[0], out) is out


def test_turned_frames_are_laid_upright() -> None:
    velocity, angle = Velocity(20.0, -12.0), np.deg2rad(9.0)
    r, (y, x) = GRID.shutter.line_periods_per_frame, (np.arange(GRID.side) - c for c in GRID.centre)
    y, x = np.meshgrid(y, x, indexing="ij")
    y, x = y * (1 + velocity.row / r), x + velocity.col * y / r
    rows = np.cos(angle) * y - np.sin(angle) * x
    cols = np.sin(angle) * y + np.cos(angle) * x
    image = wave(30.2 + rows, -11.7 + cols).astype(np.float32)
    mosaic = Mosaic(GRID)
    mosaic.insert(image, 30.2, -11.7, velocity, angle)
    assert miss(mosaic) < 1.0
    unturned = Mosaic(GRID)
    unturned.insert(image, 30.2, -11.7, velocity)
    assert miss(unturned) > 10


def test_rim_weights_turn_with_a_turned_frame() -> None:
    """Where the line has left the bundle the frame counts little, whichever way the probe is turned."""
    weights = rim_weights(GRID, 25.0)
    mosaic = Mosaic(GRID, Insertion.FEATHERED, weights=weights)
    mosaic.insert(np.full((120, 120), 50.0, np.float32), *GRID.centre, angle=np.pi / 2)
    _, weight = mosaic.read(Rectangle(0, 0, 120, 120))
    row, col = (round(c) for c in GRID.centre)
    assert weight[row, col] == pytest.approx(weights[row, col], abs=1e-3)
    low, high = weights[row + 45, col], weights[row - 45, col]
    assert low < 0.2 * high
    turned = [weight[row, col + 45], weight[row, col - 45]]
    assert min(turned) == pytest.approx(low, abs=0.1)
    assert max(turned) == pytest.approx(high, abs=0.1)
    assert weight[row + 45, col] > 0.5 * high


def test_turned_frames_are_interpolated_once() -> None:
    """A fine pattern at a fraction of a pixel keeps the contrast that one bilinear interpolation leaves."""
    rng = np.random.default_rng(5)
    image = rng.normal(100, 20, (120, 120)).astype(np.float32)
    angle, place = np.deg2rad(7.0), (31.4, -12.3)
    mosaic = Mosaic(GRID)
    mosaic.insert(image, *place, angle=angle)
    image_at, weight = mosaic.read(Rectangle(-20, -60, 90, 50))
    row, col = np.mgrid[-20:90, -60:50].astype(float)
    y, x = row - place[0], col - place[1]
    c, s = np.cos(angle), np.sin(angle)
    back = (c * y + s * x + GRID.centre[0]).astype(np.float32), (-s * y + c * x + GRID.centre[1]).astype(np.float32)
    once = cv2.remap(image, back[1], back[0], cv2.INTER_LINEAR)
    inside = (np.hypot(y, x) < 45) & (weight > 0)
    assert inside.sum() > 5000
    assert np.abs(image_at - once)[inside].max() < 6  # OpenCV places samples to a thirty-second of a pixel
    assert image_at[inside].std() == pytest.approx(once[inside].std(), rel=0.01)


def test_a_dead_leaf_is_due_once_the_probe_has_moved_or_a_few_frames_were_left_out() -> None:
    def places(insertion: Insertion, step_px: float) -> list[int]:
        mosaic, inserted = Mosaic(GRID, insertion), []
        for k in range(12):
            pose = Pose(0, 0.0, step_px * k, STILL, 1.0, 0.1, TrackingState.TRACKED)
            if mosaic.due(pose):
                mosaic.insert(np.ones((120, 120), np.float32), pose.row, pose.col)
                inserted.append(k)
        return inserted

    step_px = 0.03 * GRID.diameter
    assert places(Insertion.DEAD_LEAF, step_px) == [0, 2, 4, 6, 8, 10]
    assert places(Insertion.DEAD_LEAF, 0.0) == [0, 4, 8]
    assert places(Insertion.FEATHERED, 0.0) == list(range(12))
