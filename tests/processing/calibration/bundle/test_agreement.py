"""Frames refuse a calibration of another geometry, and accept their own whatever they show."""

from __future__ import annotations

import numpy as np
import pytest

from napari_elsplus.errors import CalibrationError
from napari_elsplus.processing.calibration.bundle.agreement import require_agreement
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.rendering.renderer import Renderer
from napari_elsplus.simulation.specimen.scenes import scene
from napari_elsplus.simulation.truth import true_calibration
from napari_elsplus.workflows.sectioning import section

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


@pytest.mark.parametrize("view", ["confocal", "residual"])
@pytest.mark.parametrize("by", [(0.0, 30.0), (25.0, 0.0)])
def test_a_view_elsewhere_is_refused(view: str, by: tuple[float, float]) -> None:
    centre = getattr(true_calibration(INSTRUMENT).bundle, f"{view}_centre")
    wrong = moved(**{f"{view}_centre": (centre[0] + by[0], centre[1] + by[1])})
    with pytest.raises(CalibrationError, match=f"the frames show a {view} view of .* use the calibration"):
        section(frames("fibres"), wrong, "els")


def test_another_diameter_is_refused() -> None:
    with pytest.raises(CalibrationError, match="the frames show"):
        require_agreement(frames("fibres"), moved(diameter_px=0.85 * INSTRUMENT.diameter_px))


def test_noise_contradicts_nothing() -> None:
    noise = np.random.default_rng(2).poisson(20, (1, *INSTRUMENT.frame_shape)).astype(np.uint8)
    require_agreement(noise, true_calibration(INSTRUMENT))
    require_agreement(noise, replace_bundle_by_none())


def replace_bundle_by_none() -> object:
    return true_calibration(INSTRUMENT).model_copy(update={"bundle": None})
