"""Power of the laser that differs from row to row, taken off images."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from napari_elsplus.errors import CalibrationError, InputError
from napari_elsplus.processing.calibration.calibrate import measure
from napari_elsplus.processing.images.row_power import RowPower
from napari_elsplus.processing.images.sectioning import Mode, Sectioner, disc
from napari_elsplus.simulation.calibration_scenes import background, transmission
from napari_elsplus.simulation.model.imperfections import Imperfections
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.rendering.renderer import Renderer
from napari_elsplus.simulation.specimen.scenes import Plane, Scene
from napari_elsplus.simulation.specimen.textures import Mottle, Nuclei
from napari_elsplus.workflows.sectioning import section

STEADY = Instrument.of("240hz")
HAZY = Scene((Plane(Nuclei(seed=7330), 0.0, 0.2), Plane(Mottle(seed=7330), 150.0, 2.0)))


@pytest.fixture(scope="module")
def calibration():
    known = measure(bundle=list(transmission(STEADY, seed=7331))[:8]).calibration
    return known.model_copy(update={"background": background(STEADY)})


def test_power_noise_is_taken_off_hazy_images_and_steady_ones_are_left_alone(calibration) -> None:
    sectioner = Sectioner(calibration, STEADY.frame_shape)
    power = RowPower(sectioner, calibration)
    judged = disc(sectioner.side, 0.9 * sectioner.diameter_px)
    steady = Renderer(STEADY, HAZY, seed=7332).render(0)
    wanted = sectioner.els(steady).copy()
    assert np.array_equal(power.image(steady, Mode.ELS), wanted)
    noisy = replace(STEADY, imperfections=Imperfections(power_noise_percent=5.0))
    raw = Renderer(noisy, HAZY, seed=7332).render(0)
    left = np.std((power.image(raw, Mode.ELS) - wanted)[judged])
    assert left < 0.5 * np.std((sectioner.els(raw) - wanted)[judged])
    els = power.image(raw, Mode.LS) - power.image(raw, Mode.RESIDUAL)
    assert np.array_equal(power.image(raw, Mode.ELS), els)
    found = section(raw[None], calibration, "els", row_power=True)[0]
    assert found == pytest.approx(els, abs=1e-3)


def test_elsa_and_a_calibration_without_flat_field_are_refused(calibration) -> None:
    raw = np.zeros((2, *STEADY.frame_shape), np.uint8)
    with pytest.raises(CalibrationError, match="no flat field"):
        section(raw, calibration.model_copy(update={"flat": None}), row_power=True)
    with pytest.raises(InputError, match="choose els"):
        section(raw, calibration, "elsa", row_power=True)[0]
