"""Row noise of the camera taken off raw frames before images are made."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from napari_elsplus.processing.images.sectioning import Sectioner, disc
from napari_elsplus.simulation.calibration_scenes import background
from napari_elsplus.simulation.model.imperfections import Imperfections
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.rendering.renderer import Renderer
from napari_elsplus.simulation.specimen.scenes import nuclei
from napari_elsplus.simulation.truth import true_calibration


@pytest.mark.parametrize("row_noise_dn", [0.0, 2.0])
def test_images_are_free_of_row_noise_and_unchanged_without_it(row_noise_dn: float) -> None:
    steady = Instrument.of("240hz")
    noisy = replace(steady, imperfections=Imperfections(row_noise_dn=row_noise_dn))
    calibration = true_calibration(steady, background(steady))
    plain, referenced = (Sectioner(calibration, steady.frame_shape, row_reference=on) for on in (False, True))
    scene = nuclei(7320)
    wanted = plain.els(Renderer(steady, scene, seed=7321).render(0)).copy()
    raw = Renderer(noisy, scene, seed=7321).render(0)
    off = [np.std((one.els(raw) - wanted)[disc(plain.side, 0.9 * plain.diameter_px)]) for one in (plain, referenced)]
    if row_noise_dn:
        assert off[1] < 0.5 * off[0]
    else:
        assert np.array_equal(plain.els(raw).copy(), referenced.els(raw), equal_nan=True)
    assert np.array_equal(referenced.ls(raw) - referenced.residual(raw), referenced.els(raw))
