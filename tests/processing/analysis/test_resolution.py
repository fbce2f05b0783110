from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from napari_elsplus.errors import InputError, MeasurementError
from napari_elsplus.instrument.optics import CORE_PITCH_UM
from napari_elsplus.processing.analysis.resolution import BarElement, element_contrast, smallest_resolved_line_pair_um
from napari_elsplus.processing.images.sectioning import Sectioner
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.rendering.renderer import Renderer
from napari_elsplus.simulation.specimen.pictures import usaf_1951
from napari_elsplus.simulation.specimen.scenes import Plane, Scene
from napari_elsplus.simulation.specimen.trajectories import Still
from napari_elsplus.simulation.truth import true_calibration

WIDTHS_PX = (12, 8, 6, 4, 3, 2)


def target() -> tuple[NDArray[np.float64], list[BarElement]]:
    """Elements of three upright and three lying bars each, 1 um a pixel."""
    image, elements, top = np.zeros((320, 160)), [], 4
    for width in WIDTHS_PX:
        upright = tuple((top, 4 + 2 * k * width, top + 5 * width, 4 + (2 * k + 1) * width) for k in range(3))
        lying = tuple((top + 2 * k * width, 80, top + (2 * k + 1) * width, 80 + 5 * width) for k in range(3))
        for bars in (upright, lying):
            elements.append(BarElement(2.0 * width, bars))
            for t, left, bottom, right in bars:
                image[t:bottom, left:right] = 100
        top += 5 * width + 6
    return image, elements


def test_a_sharp_target_is_resolved_to_its_finest_element() -> None:
    image, elements = target()
    assert {element_contrast(image, element) for element in elements} == {1.0}
    assert smallest_resolved_line_pair_um(image, elements) == 4.0


def test_blur_takes_the_fine_elements_first() -> None:
    image, elements = target()
    resolved = [smallest_resolved_line_pair_um(gaussian_filter(image, sigma), elements) for sigma in (0.5, 1.5, 2.5, 4)]
    assert resolved == sorted(resolved)
    assert resolved[0] == 4.0
    assert resolved[-1] >= 12.0


def test_a_period_counts_only_if_both_orientations_are_resolved() -> None:
    image, elements = target()
    smeared = gaussian_filter(image, (0, 4))
    assert smallest_resolved_line_pair_um(smeared, elements) > smallest_resolved_line_pair_um(smeared, elements[1::2])


def test_what_cannot_be_measured_is_said() -> None:
    image, elements = target()
    with pytest.raises(MeasurementError, match=r"contrast below 0\.1 at 24\.0 um"):
        smallest_resolved_line_pair_um(np.full_like(image, 50), elements)
    with pytest.raises(InputError, match="0 elements"):
        smallest_resolved_line_pair_um(image, [])
    with pytest.raises(InputError, match="outside of the image"):
        element_contrast(image[:20], elements[-1])
    with pytest.raises(InputError, match="1 bars"):
        element_contrast(image, BarElement(4.0, ((0, 0, 5, 5),)))


def test_the_bundle_resolves_two_cores_a_line_pair() -> None:
    instrument = Instrument.of("240hz")
    picture, probe_row_um = usaf_1951((6, 7)), -190.0
    scene = Scene((Plane(picture),), transmission=True)
    raw = Renderer(instrument, scene, Still(probe_row_um, 0.0)).render(0)
    sectioner = Sectioner(true_calibration(instrument), instrument.frame_shape)
    image = sectioner.ls(raw - instrument.black_dn)
    um_per_px, middle = instrument.optics.um_per_px, sectioner.side / 2
    elements = []
    for first in range(0, len(picture.bars_um), 6):
        for way in range(2):
            bars_um = np.array(picture.bars_um[first + way : first + 6 : 2])
            bars_px = middle + (bars_um - (probe_row_um, 0, probe_row_um, 0)) / um_per_px
            top, left, bottom, right = bars_um[0]
            elements.append(BarElement(2 * min(bottom - top, right - left), tuple(map(tuple, bars_px))))
    resolved_um = smallest_resolved_line_pair_um(image, elements)
    assert resolved_um == pytest.approx(2 * CORE_PITCH_UM, rel=0.13)  # one element finer or coarser
