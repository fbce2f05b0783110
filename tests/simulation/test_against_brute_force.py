"""The fast renderer against the slow one, on a small bundle with every term at work."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from brute_force import core_values

from napari_elsplus.instrument.optics import Optics, Preset
from napari_elsplus.simulation.model.axial_response import LineModel
from napari_elsplus.simulation.model.bundle import Bundle
from napari_elsplus.simulation.model.imperfections import Imperfections
from napari_elsplus.simulation.model.instrument import Instrument, ResidualView
from napari_elsplus.simulation.rendering.renderer import Renderer
from napari_elsplus.simulation.specimen.pictures import ImageTexture
from napari_elsplus.simulation.specimen.scenes import Plane, Scene
from napari_elsplus.simulation.specimen.textures import Fibres, Mottle, Nuclei, Texture, Uniform

SMALL = Instrument(
    Preset("small", (200, 420), (0, 0), "10x", Optics(1.0, line_periods_per_frame=210.0)),
    slit_rows=3,
    offset_rows=-8,
    bundle=Bundle(diameter_um=150.0, jitter=0.0),
    line=LineModel(core_um=4.0, halo_share=0.6, halo_um=12.0, spread=0.236, gap_um=0.0),
    residual_view=ResidualView(gain=1.0, rotation_deg=0.0, scale=1.0),
    line_tilt_deg=0.0,
    autofluorescence=0.0,
)


HALVED = Imperfections.parse("halo-in-collection=50")


def drawn(texture: Texture, step_um: float = 0.4, reach_um: float = 150.0) -> ImageTexture:
    """Draw a texture once: generators soften their edges by the step they are asked for, a picture does not."""
    axis = np.arange(-reach_um, reach_um, step_um)
    return ImageTexture(texture.sample(axis, axis), step_um)


SCENES = {
    "uniform, in contact": Scene((Plane(Uniform()),)),
    "nuclei over fibres over a ground": Scene(
        (
            Plane(drawn(Nuclei())),
            Plane(drawn(Fibres(width_um=10.0, per_mm2=200.0)), 15.0, 0.8),
            Plane(drawn(Mottle(40.0)), 50.0),
        )
    ),
}


@pytest.mark.parametrize("name", SCENES)
def test_cores_receive_what_the_slow_way_gives(name: str) -> None:
    compare(SMALL, SCENES[name])


def test_halo_on_the_way_back_is_what_the_slow_way_gives() -> None:
    compare(replace(SMALL, imperfections=HALVED), Scene((Plane(drawn(Nuclei())),)), interior=0.01)


def compare(instrument: Instrument, scene: Scene, interior: float = 0.005) -> None:
    renderer = Renderer(instrument, scene, noise=False)
    cores = SMALL.bundle.cores()
    radius = np.hypot(cores.rows_um, cores.cols_um) / SMALL.bundle.radius_um
    for values, offset_um in zip(renderer.core_values(0), (0.0, SMALL.offset_um), strict=True):
        slow = core_values(instrument, scene, cores, offset_um)
        scale = slow[radius < 0.85].mean()
        off = (values - slow) / scale
        assert np.sqrt((off[radius < 0.85] ** 2).mean()) < interior
        assert np.sqrt((off[radius >= 0.85] ** 2).mean()) < 0.04


def test_a_line_off_its_slit_is_a_slit_offset() -> None:
    """Confocal cores under a line that stands 6 rows late receive what a residual view at 6 rows does."""
    scene = SCENES["nuclei over fibres over a ground"]
    late = Renderer(SMALL, scene, noise=False)
    aside = Renderer(replace(SMALL, offset_rows=6.0), scene, noise=False)
    confocal = late.core_values(0, line_rows=np.arange(200.0) + 6)[0]
    assert confocal == pytest.approx(aside.core_values(0)[1], rel=3e-3)
