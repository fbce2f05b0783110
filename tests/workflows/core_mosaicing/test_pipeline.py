"""Mosaics of cores: finer than the cores where the probe moved, from recordings and from stacks of bundle images."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pytest
import tifffile

from benchmarks.choices.enhancement import Group, Picture, contrast
from benchmarks.rigs.simulated import SimulatedRig, StopAndGo, measured
from napari_elsplus.cli import main
from napari_elsplus.errors import InputError
from napari_elsplus.instrument.optics import CORE_PITCH_UM
from napari_elsplus.processing.images.sectioning import Mode, Sectioner
from napari_elsplus.processing.mosaicing.line_light import LineLight
from napari_elsplus.processing.mosaicing.mosaic import Insertion
from napari_elsplus.simulation.model.bundle import Bundle
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.specimen.pictures import Bars
from napari_elsplus.simulation.specimen.scenes import Plane, Scene
from napari_elsplus.viewing.mosaic.recorded import StackMosaics
from napari_elsplus.workflows import tracking
from napari_elsplus.workflows.mosaic_plan import MosaicPlan
from napari_elsplus.workflows.mosaicing import MosaicResult, mosaic
from napari_elsplus.workflows.sectioning import section

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from napari_elsplus.processing.tracking.front_end.grid import Grid

FRAMES, PERIOD_UM = 12, 1.2 * CORE_PITCH_UM
FINE = (Group(PERIOD_UM, -40.0, -40.0, True), Group(PERIOD_UM, 10.0, 10.0, False))


class Motion(NamedTuple):
    rig: SimulatedRig
    raw: NDArray[np.uint8]
    places_px: NDArray[np.float64]


@cache
def recorded(reach_um: float = 8.0) -> Motion:
    """Frames of a small bundle at rest over fine bars among coarse ones, between moves."""
    rig = measured(replace(Instrument.of("240hz"), bundle=Bundle(diameter_um=200.0)))
    random = np.random.default_rng(1)
    bars = [(top, left, top + height, left + 7.0)
            for top, left, height in zip(*random.uniform(-90, 90, (2, 40)), random.uniform(6, 40, 40), strict=True)
            if not (-45 < left < 45 and top + height > -45 and top < 45)]  # fmt: skip
    for group in FINE:
        steps = [(group.top, group.left + k * PERIOD_UM) if group.upright else (group.top + k * PERIOD_UM, group.left)
                 for k in range(5)]  # fmt: skip
        wide = (24.0, PERIOD_UM / 2) if group.upright else (PERIOD_UM / 2, 24.0)
        bars += [(top, left, top + wide[0], left + wide[1]) for top, left in steps]
    places = random.uniform(-reach_um, reach_um, (FRAMES, 2))
    path = StopAndGo(places, rig.instrument.optics.frame_period_s)
    raw = rig.recording(Scene((Plane(Bars(tuple(bars))),)), path, FRAMES, seed=2)
    return Motion(rig, raw, places / rig.um_per_px)


def contrasts(made: MosaicResult, motion: Motion) -> list[float]:
    scale = made.um_per_px
    assert scale is not None
    (row, col), first = made.first_frame_px, motion.places_px[0] * motion.rig.um_per_px
    picture = Picture(made.image, scale, first[0] - row * scale, first[1] - col * scale)
    return [contrast(picture, group) for group in FINE]


def test_bars_finer_than_one_frame_resolves_are_resolved() -> None:
    motion = recorded()
    made = mosaic(motion.raw, motion.rig.calibration, "ls", insertion="cores")
    assert min(contrasts(made, motion)) > 0.3
    assert made.settings["insertion"] == "cores"
    sectioner = Sectioner(motion.rig.calibration, motion.raw[0].shape)
    um, first = motion.rig.um_per_px, motion.places_px[0] * motion.rig.um_per_px
    one = section(motion.raw, motion.rig.calibration, "ls", cores="interpolate")[0]
    corner = first - np.array(sectioner.centre) * um
    assert max(contrast(Picture(one, um, *corner), group) for group in FINE) < 0.1


def test_elsplus_and_rolling_shutter_go_through_the_same_samples() -> None:
    motion = recorded()
    made = mosaic(motion.raw, motion.rig.calibration, "els", insertion="cores")
    assert min(contrasts(made, motion)) > 0.3


def test_uneven_light_of_rows_and_columns_is_taken_out_of_the_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    motion, images = recorded(), []
    for relative in (1.0, 2.0):

        def estimate(_image: object, _poses: object, grid: Grid, relative: float = relative) -> LineLight:
            light = np.full((grid.side, grid.side), relative, np.float32)
            return LineLight(light, departure=1.0, uncertainty=0.0, spread=(relative, relative))

        monkeypatch.setattr(tracking, "estimate_line_light", estimate)
        images.append(mosaic(motion.raw, motion.rig.calibration, "els", insertion="cores").image)
    np.testing.assert_allclose(2 * images[1], images[0], rtol=1e-4, atol=1e-3 * np.nanmax(images[0]))


@pytest.mark.parametrize(
    ("reach_um", "with_flat"),
    [
        (8.0, False),
        *(pytest.param(*case, marks=pytest.mark.slow) for case in ((3.0, True), (60.0, True), (60.0, False))),
    ],
)
def test_the_core_pattern_does_not_hold_the_frames_of_a_stack(reach_um: float, with_flat: bool) -> None:
    motion = recorded(reach_um)
    images = section(motion.raw, motion.rig.calibration, "ls")[:]
    flat = motion.rig.calibration.flat if with_flat else None
    made = mosaic(images, finished=True, insertion="cores", flat=flat)
    found = np.array([(row.row_px, row.col_px) for row in made.track])
    true = motion.places_px - motion.places_px[0]
    assert np.hypot(*(found - true).T).max() < 0.5


def test_the_panel_shows_the_same_mosaic_and_its_scale() -> None:
    motion = recorded()
    plan = MosaicPlan((Mode.ELS, Mode.LS), insertion=Insertion.CORES)
    mosaics = StackMosaics(motion.raw, motion.rig.calibration, plan)
    mosaics.run()
    made = mosaic(motion.raw, motion.rig.calibration, "els", insertion="cores")
    np.testing.assert_array_equal(mosaics.canvases[Mode.ELS][0].read()[0], made.image)
    assert mosaics.canvases[Mode.LS][0].read()[0].shape == made.image.shape
    assert mosaics.scale.um_per_px == pytest.approx(made.um_per_px) == pytest.approx(CORE_PITCH_UM / 4, rel=0.02)


def test_frames_that_do_not_move_are_refused_with_the_motion_that_is_needed() -> None:
    motion = recorded(0.1)
    with pytest.raises(InputError, match=r"within 0\.\d+ px of each other: insertion by cores needs 1\.2 px"):
        mosaic(motion.raw, motion.rig.calibration, "ls", insertion="cores")
    with pytest.raises(InputError, match="2 tracked frames: insertion by cores needs 3"):
        mosaic(motion.raw[:2], motion.rig.calibration, "ls", insertion="cores")


def test_images_without_cores_and_calibrations_without_a_flat_field_are_refused() -> None:
    motion = recorded()
    smooth = np.random.default_rng(0).normal(50, 1, (4, 120, 120)).astype(np.float32)
    with pytest.raises(InputError, match="the cores are not resolved"):
        mosaic(smooth, finished=True, insertion="cores")
    dark = motion.rig.calibration.model_copy(update={"flat": None})
    with pytest.raises(InputError, match="no flat field"):
        mosaic(motion.raw, dark, "ls", insertion="cores")
    with pytest.raises(InputError, match="a flat field was given"):
        mosaic(motion.raw, motion.rig.calibration, flat=motion.raw[0])


def test_the_command_line_takes_a_stack_and_its_flat_field(tmp_path: Path) -> None:
    motion = recorded()
    tifffile.imwrite(tmp_path / "stack.tif", section(motion.raw, motion.rig.calibration, "ls")[:6])
    tifffile.imwrite(tmp_path / "flat.tif", motion.rig.calibration.flat)
    given = ["stack.tif", "--finished", "--insertion", "cores", "--flat", "flat.tif", "-o", "out.tif"]
    main(["mosaic", *(str(tmp_path / word) if word.endswith(".tif") else word for word in given)])
    assert min(tifffile.imread(tmp_path / "out.tif", level=0).shape) > 150 / 2.4 * 4
