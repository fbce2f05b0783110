from __future__ import annotations

import numpy as np
import pytest

from napari_elsplus.errors import InputError
from napari_elsplus.simulation.specimen.layers import Blur, Layer, join_windows
from napari_elsplus.simulation.specimen.pictures import ImageTexture, usaf_1951
from napari_elsplus.simulation.specimen.scenes import SCENES, Plane, picture, scene
from napari_elsplus.simulation.specimen.textures import Fibres, Mottle, Nuclei, Texture, Uniform


@pytest.mark.parametrize("texture", [Fibres(), Nuclei(), Mottle()])
@pytest.mark.parametrize("place_um", [0.0, -3.0e4, 2.0e6])
def test_tissue_is_the_same_wherever_one_looks_from(texture: Texture, place_um: float) -> None:
    axis = np.arange(place_um, place_um + 120, 1.0)
    whole = texture.sample(axis, axis)
    part = texture.sample(axis[40:80], axis[70:110])
    assert part == pytest.approx(whole[40:80, 70:110], abs=1e-4)
    assert whole.std() > 0.02


def test_another_seed_is_another_tissue() -> None:
    axis = np.arange(0.0, 200.0)
    for kind in (Fibres, Nuclei, Mottle):
        assert not np.allclose(kind(seed=1).sample(axis, axis), kind(seed=2).sample(axis, axis))


def test_fibres_keep_their_density_and_do_not_repeat() -> None:
    axis = np.arange(0.0, 6000.0, 6.0)
    tissue = Fibres(per_mm2=40).sample(axis, axis)
    quarters = [tissue[i : i + 500, j : j + 500] for i in (0, 500) for j in (0, 500)]
    covered = [float((quarter > 0.2).mean()) for quarter in quarters]
    assert max(covered) < 1.3 * min(covered)
    assert all(abs(np.corrcoef(quarters[0].ravel(), other.ravel())[0, 1]) < 0.1 for other in quarters[1:])


def test_layer_is_the_blurred_texture_however_it_is_reached() -> None:
    """A window that has rolled over the place twice holds what one that came straight there holds."""
    blur = Blur(3.0, 5.0)
    straight, wandering = (Layer(Nuclei(), blur, 60.0) for _ in range(2))
    for place in (0.0, 700.0, -900.0, 350.0):
        wandering.cover(place - 60, place - 60, place + 60, place + 60)
    straight.cover(290.0, 290.0, 410.0, 410.0)
    index = (np.arange(290, 410) / straight.step_um).astype(int) & (straight.size - 1)
    held = np.ix_(index, index)
    assert np.array_equal(straight.window[held], wandering.window[held])
    assert straight.window.nbytes < 2e6


def test_windows_repeat_their_first_row_and_column_at_the_end_also_after_they_are_joined() -> None:
    layers = [Layer(Nuclei(), blur, 60.0) for blur in (Blur(3.0, 5.0), Blur(8.0, 8.0))]
    layers[0].cover(-60, -60, 60, 60)
    before = layers[0].window.copy()
    samples, first = join_windows(layers)
    assert np.array_equal(layers[0].window, before)
    for place in (0.0, 700.0, -900.0):
        for layer, begin in zip(layers, first, strict=True):
            layer.cover(place - 60, place - 60, place + 60, place + 60)
            window = samples[begin : begin + (layer.size + 1) ** 2].reshape(layer.size + 1, -1)
            assert window.any()
            assert np.array_equal(window[-1], window[0])
            assert np.array_equal(window[:, -1], window[:, 0])


def test_layer_blurs_by_what_it_is_told() -> None:
    point = np.zeros((401, 401))
    point[200, 200] = 1
    layer = Layer(ImageTexture(point, 0.5), Blur(4.0, 8.0), 40.0)
    layer.cover(-40, -40, 40, 40)
    index = np.arange(-25, 26)
    seen = layer.window[np.ix_(index & (layer.size - 1), index & (layer.size - 1))]
    place_um = index * layer.step_um
    extra = layer.step_um**2 / 6  # bilinear sampling adds this much
    for axis, sigma in ((1, 4.0), (0, 8.0)):
        profile = seen.sum(axis)
        assert (profile * place_um**2).sum() / profile.sum() == pytest.approx(sigma**2 - extra, rel=0.03)


def test_a_frame_that_spans_more_than_the_window_is_refused() -> None:
    layer = Layer(Nuclei(), Blur(1.0, 1.0), 50.0)
    with pytest.raises(InputError, match="one frame spans 5000 um"):
        layer.cover(0.0, 0.0, 5000.0, 10.0)


def test_usaf_elements_have_the_pitch_of_their_number() -> None:
    step = 0.25
    axis = np.arange(-300.0, 300.0, step)
    target = usaf_1951(groups=(4,)).sample(axis, axis)
    column = target[:, int((-248 + 300) / step)]  # through the horizontal bars of element 1: 16 line pairs per mm
    rises = np.flatnonzero(np.diff((column > 0.5).astype(int)) == 1)[:3]
    assert np.diff(rises) * step == pytest.approx([62.5, 62.5], abs=step)


def test_image_lies_about_the_origin_and_keeps_its_mean_when_coarse() -> None:
    rng = np.random.default_rng(0)
    image = ImageTexture(rng.integers(1, 200, (200, 300)).astype(np.uint16), 0.5)
    assert image.bounds_um == (-49.75, -74.75, 49.75, 74.75)
    fine, coarse = (np.arange(-40.0, 40.0, step) for step in (0.5, 4.0))
    assert image.sample(coarse, coarse).mean() == pytest.approx(image.sample(fine, fine).mean(), rel=0.01)


@pytest.mark.parametrize(
    ("bad", "word"),
    [(np.zeros((3, 4, 3)), "shape"), (np.zeros((9, 9)), "largest value is 0"), (np.full((9, 9), np.nan), "nan")],
)
def test_what_is_no_scene_is_refused(bad: np.ndarray, word: str) -> None:
    with pytest.raises(InputError, match=word):
        picture(bad, 1.0)


@pytest.mark.parametrize("depth_um", [-1.0, float("nan"), 1e4])
def test_impossible_planes_are_refused(depth_um: float) -> None:
    with pytest.raises(InputError, match=f"depth of {depth_um}"):
        Plane(Uniform(), depth_um)


def test_every_scene_has_its_name() -> None:
    assert {"fibres", "sparse", "nuclei", "usaf", "uniform", "empty", "paper"} <= set(SCENES)
    assert scene("usaf").transmission
    assert scene("empty").planes == ()
    assert [plane.depth_um for plane in scene("fibres").in_focus().planes] == [0]
    assert scene("plate:120").planes[0].depth_um == 120
