from __future__ import annotations

import cv2
import numpy as np
import pytest

from napari_elsplus.errors import InputError
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.rendering.renderer import Renderer
from napari_elsplus.simulation.specimen.scenes import picture, scene
from napari_elsplus.simulation.specimen.trajectories import Still, Straight, Turning


@pytest.fixture(scope="module")
def renderer() -> Renderer:
    return Renderer(Instrument.of("240hz"), scene("nuclei"), Straight(2000), seed=3)


def test_same_seed_and_index_make_the_same_frame_in_any_order(renderer: Renderer) -> None:
    again = Renderer(Instrument.of("240hz"), scene("nuclei"), Straight(2000), seed=3)
    far = again.render(40)
    assert np.array_equal(renderer.render(2), again.render(2))
    assert np.array_equal(renderer.render(40), far)
    assert not np.array_equal(renderer.render(2), renderer.render(3))


def test_a_line_where_it_should_be_is_the_ideal_scan(renderer: Renderer) -> None:
    ideal = renderer.render(5)
    rows = np.arange(renderer.frame_shape[0], dtype=float)
    assert np.array_equal(renderer.render(5, line_rows=rows), ideal)


def test_a_lagging_line_dims_the_confocal_image_and_brightens_the_residual(renderer: Renderer) -> None:
    rows = np.arange(renderer.frame_shape[0], dtype=float)
    half = renderer.frame_shape[1] // 2
    ideal = renderer.render(5).astype(float)
    # offset is negative: the line stands above the residual's slit, and a line that comes late stands nearer to it
    late = renderer.render(5, line_rows=rows + 4).astype(float)
    assert late[:, :half].mean() < 0.97 * ideal[:, :half].mean()
    assert late[:, half:].mean() > 1.02 * ideal[:, half:].mean()
    assert np.array_equal(renderer.render(5), ideal)


def test_laser_off_leaves_the_black_level(renderer: Renderer) -> None:
    dark = renderer.render(5, line_rows=np.full(renderer.frame_shape[0], np.nan))
    assert abs(dark.mean() - renderer.instrument.black_dn) < 0.05


def test_leaving_a_finite_scene_is_said_with_the_frame() -> None:
    small = picture(np.eye(1000), um_per_px=1.0)
    renderer = Renderer(Instrument.of("240hz"), small, Straight(20_000, direction_deg=0))
    renderer.render(0)
    with pytest.raises(InputError, match=r"frame 4 is \d+ um beyond the edge of the scene of 999 x 999 um"):
        renderer.render(4)


def test_a_turned_probe_sees_the_scene_turned() -> None:
    """Turned by 90 degrees, a picture looks as its transpose, mirrored, does upright."""
    image = cv2.GaussianBlur(np.random.default_rng(0).uniform(0, 255, (801, 801)), (0, 0), 6.0)
    quarter = Turning(Still(), 90.0 / 1e-3, np.inf)

    class Held:
        """At 90 degrees throughout."""

        def positions_um(self, times_s: np.ndarray) -> np.ndarray:
            return quarter.positions_um(times_s)

        def angles_rad(self, times_s: np.ndarray) -> np.ndarray:
            return quarter.angles_rad(np.full_like(times_s, 1e-3))

    instrument = Instrument.of("240hz", autofluorescence=0.0)
    turned = Renderer(instrument, picture(image, 2.0), Held(), noise=False).in_focus().render(0)
    # up the rows of the turned probe runs along the scene's columns
    other = picture(np.ascontiguousarray(image.T[:, ::-1]), 2.0)
    upright = Renderer(instrument, other, Still(), noise=False).in_focus().render(0)
    centre = [round(c) for c in instrument.confocal_centre]
    here = np.s_[centre[0] - 150 : centre[0] + 150, centre[1] - 150 : centre[1] + 150]
    smooth = [cv2.GaussianBlur(frame[here].astype(float), (0, 0), 3.0).ravel() for frame in (turned, upright)]
    assert np.corrcoef(*smooth)[0, 1] > 0.99
