"""Frames refuse a calibration of another geometry or bit depth, and accept their own whatever they show."""

from __future__ import annotations

import re
import warnings
from typing import TYPE_CHECKING

import numpy as np
import pytest

from napari_elsplus.errors import CalibrationError
from napari_elsplus.io import write_calibration, write_images
from napari_elsplus.processing.calibration.bundle.agreement import grey_level_note, require_agreement
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.rendering.renderer import Renderer
from napari_elsplus.simulation.specimen.scenes import scene
from napari_elsplus.simulation.truth import true_calibration
from napari_elsplus.viewing.axial import measure_scan
from napari_elsplus.viewing.comparison import compare_stack
from napari_elsplus.viewing.layers import open_layers
from napari_elsplus.viewing.lazy import LazyPlanes
from napari_elsplus.viewing.mosaic.recorded import StackMosaics
from napari_elsplus.viewing.stack import Stack
from napari_elsplus.workflows.comparison import compare
from napari_elsplus.workflows.mosaic_plan import MosaicPlan
from napari_elsplus.workflows.mosaicing import mosaic
from napari_elsplus.workflows.sectioning import section

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

INSTRUMENT = Instrument.of("240hz")


def frames(name: str, instrument: Instrument = INSTRUMENT) -> list[np.ndarray]:
    return [Renderer(instrument, scene(name, 5), seed=5).render(0)]


@pytest.mark.parametrize("name", ["fibres", "sparse", "nuclei", "usaf", "uniform", "empty"])
def test_a_calibration_of_these_frames_is_accepted_whatever_they_show(name: str) -> None:
    require_agreement(frames(name), true_calibration(INSTRUMENT))


@pytest.mark.parametrize("offset_um", [-60.0, 12.0])
def test_the_rim_that_the_line_has_left_is_no_contradiction(offset_um: float) -> None:
    instrument = Instrument.of("240hz", offset_um=offset_um)
    require_agreement(frames("sparse", instrument), true_calibration(instrument))


def moved(**of_bundle: object) -> object:
    known = true_calibration(INSTRUMENT)
    assert known.bundle is not None
    return known.model_copy(update={"bundle": known.bundle.model_copy(update=of_bundle)})


def moved_by_30_px() -> object:
    bundle = true_calibration(INSTRUMENT).bundle
    assert bundle is not None
    places = {name: getattr(bundle, name) for name in ("confocal_centre", "residual_centre")}
    return moved(**{name: (row, col + 30.0) for name, (row, col) in places.items()})


@pytest.mark.parametrize("view", ["confocal", "residual"])
@pytest.mark.parametrize("by", [(0.0, 30.0), (25.0, 0.0)])
def test_a_view_elsewhere_is_refused(view: str, by: tuple[float, float]) -> None:
    centre = getattr(true_calibration(INSTRUMENT).bundle, f"{view}_centre")
    wrong = moved(**{f"{view}_centre": (centre[0] + by[0], centre[1] + by[1])})
    with pytest.raises(CalibrationError, match=f"the frames show a {view} view of .* use the calibration"):
        section(frames("fibres"), wrong, "els")


@pytest.mark.parametrize(
    "panel",
    [
        pytest.param(compare_stack, id="compare"),
        pytest.param(measure_scan, id="axial"),
        pytest.param(lambda stack, wrong: StackMosaics(stack.planes, wrong, MosaicPlan()).run(), id="mosaic"),
    ],
)
def test_the_panels_refuse_a_view_elsewhere(panel: Callable[[Stack, object], object]) -> None:
    raw = frames("fibres") * 2
    planes = LazyPlanes(raw.__getitem__, (len(raw), *INSTRUMENT.frame_shape), np.dtype(np.uint8))
    with pytest.raises(CalibrationError, match=r"the frames show a confocal view of .* use the calibration"):
        panel(Stack("scan", planes, depth_um=np.arange(2.0)), moved_by_30_px())


def test_a_recording_whose_views_lie_elsewhere_is_opened_as_raw_frames(tmp_path: Path) -> None:
    write_images(tmp_path / "scan.ome.tif", np.stack(frames("fibres") * 2))
    write_calibration(tmp_path / "scan.calibration.json", moved_by_30_px())
    opened = open_layers(tmp_path / "scan.ome.tif")
    assert len(opened.layers) == 1
    assert "raw frames only. the frames show a confocal view" in opened.notes[0]


def test_another_diameter_is_refused() -> None:
    with pytest.raises(CalibrationError, match="the frames show"):
        require_agreement(frames("fibres"), moved(diameter_px=0.85 * INSTRUMENT.diameter_px))


def test_noise_contradicts_nothing() -> None:
    noise = np.random.default_rng(2).poisson(20, (1, *INSTRUMENT.frame_shape)).astype(np.uint8)
    require_agreement(noise, true_calibration(INSTRUMENT))
    require_agreement(noise, replace_bundle_by_none())


def replace_bundle_by_none() -> object:
    return true_calibration(INSTRUMENT).model_copy(update={"bundle": None})


def scaled(factor: int, dtype: str = "uint16") -> list[np.ndarray]:
    return [(frame.astype(np.int64) * factor).astype(dtype) for frame in frames("nuclei")]


def with_background(factor: float) -> object:
    level = np.full(INSTRUMENT.frame_shape, INSTRUMENT.black_dn * factor, np.float32)
    return true_calibration(INSTRUMENT).model_copy(update={"background": level})


@pytest.mark.parametrize("factor", [1, 2])
def test_a_background_of_these_grey_levels_is_accepted(factor: int) -> None:
    assert grey_level_note(scaled(factor), with_background(1)) == ""
    assert grey_level_note(scaled(1), true_calibration(INSTRUMENT).model_copy(update={"background": None})) == ""


@pytest.mark.parametrize("made", [section, compare, mosaic])
def test_a_background_of_fewer_bits_is_warned_of(made: Callable[..., object]) -> None:
    shallow, few = with_background(1), scaled(16) * 3
    with pytest.warns(UserWarning, match="have grey level 64, the background of the calibration 4, .* bit depth"):
        made(few, shallow) if made is not mosaic else warnings.warn("; ".join(mosaic(few, shallow).notes), stacklevel=1)


def test_the_panels_note_a_background_of_fewer_bits(tmp_path: Path) -> None:
    write_images(tmp_path / "scan.ome.tif", np.stack(scaled(16) * 3))
    write_calibration(tmp_path / "scan.calibration.json", with_background(1))
    opened = open_layers(tmp_path / "scan.ome.tif")
    assert len(opened.layers) == 5
    assert "bit depth" in opened.notes[0]
    stack = opened.layers[0][1]["metadata"]["elsplus"]["stack"]
    with pytest.warns(UserWarning, match="bit depth"):
        compare_stack(stack, with_background(1))


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
def test_a_background_brighter_than_the_frames_is_refused(dtype: str) -> None:
    with pytest.raises(CalibrationError, match="bit depth"):
        section(scaled(1, dtype), with_background(16), "els")


def test_a_background_that_frames_cannot_hold_is_refused() -> None:
    with pytest.raises(CalibrationError, match="up to 280, frames of uint8 up to 255: use a calibration of this bit"):
        section(frames("nuclei"), with_background(70), "els")


@pytest.mark.parametrize(("light", "noted"), [(0.0, False), (0.3, False), (3.0, True)])
def test_a_background_with_more_light_than_the_frames_is_warned_of(light: float, noted: bool) -> None:
    """One of the lit specimen, or of another exposure: images were negative, and nothing was said."""
    known = true_calibration(INSTRUMENT)
    assert known.bundle is not None
    mean = np.mean(frames("nuclei"), axis=0) - INSTRUMENT.black_dn
    level = np.minimum(INSTRUMENT.black_dn + light * mean, 250).astype(np.float32)
    wrong = known.model_copy(update={"background": level})
    assert ("measure its background again" in grey_level_note(frames("nuclei"), wrong)) == noted


def side_by_side(name: str, *, mirrored: bool) -> tuple[list[np.ndarray], object]:
    """Return frames and their calibration, of a rig with its confocal view on the right if mirrored."""
    known = true_calibration(INSTRUMENT)
    bundle = known.bundle
    assert bundle is not None
    background = with_background(1).background
    if not mirrored:
        return frames(name), known.model_copy(update={"background": background})
    (row, col), (other_row, other_col) = bundle.residual_centre, bundle.confocal_centre
    width = INSTRUMENT.frame_shape[1] - 1
    swapped = bundle.model_copy(
        update={
            "confocal_centre": (row, width - col),
            "residual_centre": (other_row, width - other_col),
            "residual_to_confocal": ((1.0, 0.0, row - other_row), (0.0, 1.0, other_col - col)),
        }
    )
    return [frame[:, ::-1] for frame in frames(name)], known.model_copy(
        update={"bundle": swapped, "background": background}
    )


@pytest.mark.parametrize("name", ["fibres", "sparse", "nuclei", "uniform", "empty"])
@pytest.mark.parametrize("mirrored", [False, True])
def test_a_right_view_that_is_the_brighter_one_is_warned_of(name: str, mirrored: bool) -> None:
    """ELS+ was negative, and nothing was said."""
    note = grey_level_note(*side_by_side(name, mirrored=mirrored))
    assert ("times the light of the left one" in note) == mirrored


SATURATED = r"^\d+\.\d % of the pixels are saturated: lower the laser power or the gain"


def over_exposed() -> list[np.ndarray]:
    return [np.clip(frame.astype(np.int64) * 12, 0, 255).astype(np.uint8) for frame in frames("nuclei")] * 3


@pytest.mark.parametrize("made", [section, compare, mosaic])
def test_saturated_frames_are_named_first(made: Callable[..., object]) -> None:
    """Before: a mosaic that could not be tracked asked for tissue or a slower probe, and images had no note."""
    known = with_background(1).with_optics(line_periods_per_frame=None)
    bright = over_exposed()
    with pytest.warns(UserWarning, match=SATURATED):
        made(bright, known) if made is not mosaic else warnings.warn(mosaic(bright, known).notes[0], stacklevel=1)


def test_the_panels_note_saturated_frames(tmp_path: Path) -> None:
    write_images(tmp_path / "scan.ome.tif", np.stack(over_exposed()))
    write_calibration(tmp_path / "scan.calibration.json", true_calibration(INSTRUMENT))
    assert re.search(SATURATED, open_layers(tmp_path / "scan.ome.tif").notes[0])


@pytest.mark.parametrize(("share", "noted"), [(0.0005, False), (0.005, True)])
@pytest.mark.parametrize("white", [255, 4095])
def test_a_share_of_saturated_pixels_that_matters_is_noted(share: float, noted: bool, white: int) -> None:
    """Of cameras of 8 and 12 bits."""
    random = np.random.default_rng(3)
    grey = random.integers(0, white - 1, (2, *INSTRUMENT.frame_shape)).astype(np.uint8 if white == 255 else np.uint16)
    grey[random.random(grey.shape) < share] = white
    known = true_calibration(INSTRUMENT)
    found = re.search(SATURATED, grey_level_note(grey, known))
    assert (found is not None) == noted


def test_a_calibration_whose_bundle_has_a_few_pixels_is_refused_without_warnings() -> None:
    """Before: medians of nothing were taken beyond its edge, and numpy warned of them."""
    true = true_calibration(INSTRUMENT)
    assert true.bundle is not None
    tiny = true.model_copy(update={"bundle": true.bundle.model_copy(update={"diameter_px": 3.0})})
    with pytest.raises(CalibrationError, match="the calibration has it of 3 px"):
        require_agreement(frames("fibres"), tiny)
