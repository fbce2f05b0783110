"""A recording that is no dark tube is not taken for one; a dark tube's own light is."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from benchmarks.rigs.random_rigs import Rig
from napari_elsplus.errors import MeasurementError
from napari_elsplus.processing.calibration.calibrate import measure
from napari_elsplus.processing.calibration.draft import Draft, Setup
from napari_elsplus.processing.calibration.measurements import measure_background
from napari_elsplus.processing.calibration.summaries import summarize_background
from napari_elsplus.simulation.calibration_scenes import dark_tube
from napari_elsplus.simulation.model.imperfections import Imperfections
from napari_elsplus.simulation.model.instrument import Instrument

RIG = Rig(left=(112.0, 103.0), right=(98.4, 318.7), diameter_px=190.0, tilt_deg=0.5, gain=0.87)


def warned(draft: Draft) -> str:
    assert draft.background is not None
    return "; ".join(summarize_background(draft.background, draft, Setup(draft.calibration.frame)).warnings)


@pytest.mark.parametrize("voltages", [12, 60, 300])
def test_a_sweep_is_no_background(voltages: int) -> None:
    """Its mean is hardly brighter than a dark tube's, and was subtracted from every image."""
    with pytest.raises(
        MeasurementError, match=r"light moves over \d+ % of the background, as the line of a sweep does"
    ):
        measure(background=RIG.sweep(RIG.volts(voltages)), bundle=RIG.bundle())


def test_a_standing_line_is_no_background() -> None:
    assert "a line stands in the background, at row 113" in warned(measure(background=RIG.line(5)))
    with pytest.raises(
        MeasurementError, match="confocal view: the laser line does not stand out of the background: is"
    ):
        measure(background=RIG.line(5), line=replace(RIG, seed=3).line(5))


def test_the_bundle_lit_from_its_far_end_is_no_background() -> None:
    lit = RIG.bundle(4)
    assert "is 100 % as bright in the background as lit from its far end" in warned(measure(background=lit, bundle=lit))
    dim = (lit // 3).astype(np.uint8)
    assert "% as bright in the background as lit from its far end" in warned(measure(background=dim, bundle=lit))


@pytest.mark.parametrize("share", [0.0, 0.04, 0.15])
def test_a_dark_tube_with_light_of_its_own_is_a_background(share: float) -> None:
    """Autofluorescence in both views, and reflections of the fibres' faces, which flicker."""
    glow = share * RIG.lit_from_far_end() / RIG.electrons_per_dn
    random = np.random.default_rng(1)
    glow = random.normal(1, 0.01, 20)[:, None, None] * glow
    frames = np.clip(np.rint(RIG.background(20) + random.poisson(glow * 8) / 8), 0, 255).astype(np.uint8)
    frames[3, 64:74] += 20  # a flash
    found = measure(background=frames, bundle=RIG.bundle(4), line=RIG.line())
    assert found.calibration.background is not None
    assert not warned(found)


@pytest.mark.parametrize("imperfections", ["", "row-noise=2,power-noise=5,hot-pixels=0.1"])
def test_the_dark_tube_of_a_simulated_rig_is_a_background(imperfections: str) -> None:
    instrument = Instrument.of("240hz", imperfections=Imperfections.parse(imperfections))
    found = measure_background(list(islice(dark_tube(instrument), 8)))
    assert found.line_row is None


@pytest.mark.parametrize("shift", [0, 4, 6])
def test_noise_of_one_step_of_bits_that_lie_to_the_left_is_no_moving_light(shift: int) -> None:
    """Ten bits in sixteen differ by 64 where they differ at all, and most pixels of a quiet camera do not."""
    random = np.random.default_rng(4)
    frames = np.rint(random.normal(20.2, 0.35, (20, 200, 400))).astype(np.uint16) << shift
    assert measure_background(frames).mean.mean() == pytest.approx(20.2 * 2**shift, rel=0.01)


@pytest.mark.parametrize("black", [2, 3, 4])
def test_noise_about_a_low_black_level_is_no_moving_light(black: int) -> None:
    """Cut off at grey level 0, the noise of some pixels seems small by chance, where ten frames show it."""
    random = np.random.default_rng(5)
    frames = np.clip(np.rint(random.normal(black, 5, (10, 200, 400))), 0, 255).astype(np.uint8)
    assert measure_background(frames).frames == 10
