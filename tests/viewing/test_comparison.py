"""The comparison in numbers: what is scaled by what, and profiles where they are known."""

from __future__ import annotations

import numpy as np
import pytest

from napari_elsplus.errors import CalibrationError, InputError
from napari_elsplus.io import open_recording
from napari_elsplus.processing.analysis.image_quality import white_level, white_levels
from napari_elsplus.processing.analysis.line_profiles import line_profiles
from napari_elsplus.processing.images.sectioning import Mode, Sectioner
from napari_elsplus.viewing.comparison import (
    compare_stack,
    comparison_script,
    difference_planes,
)
from napari_elsplus.viewing.lazy import LazyPlanes
from napari_elsplus.viewing.stack import Stack
from pairs import calibration, frames, write_pair


def stack(count=6):
    raw = frames(count)
    return Stack("scan", LazyPlanes(raw.__getitem__, raw.shape, raw.dtype))


def test_every_mode_is_of_the_same_frame_and_elsa_takes_the_next():
    compared, sectioner, raw = compare_stack(stack(), calibration()), Sectioner(calibration(), (64, 128)), frames()
    for k, other in ((0, 1), (3, 4), (5, 4)):
        images = compared.at(k)
        np.testing.assert_array_equal(images[Mode.LS], sectioner.ls(raw[k]))
        np.testing.assert_array_equal(images[Mode.ELS], sectioner.els(raw[k]))
        np.testing.assert_array_equal(images[Mode.ELSA], sectioner.elsa(raw[k], raw[other]))


def test_one_frame_has_no_elsa():
    compared = compare_stack(stack(1), calibration())
    assert list(compared.images) == [Mode.LS, Mode.ELS]
    with pytest.raises(InputError, match="at least two"):
        difference_planes(compared, Mode.ELSA, Mode.ELS)


def test_white_is_what_the_scaling_says():
    inside = np.ones((40, 40), bool)
    rng = np.random.default_rng(0)
    images = {
        mode: rng.random((40, 40)).astype(np.float32) * top for mode, top in zip(Mode, (90, 10, 50, 60), strict=True)
    }
    own = {mode: white_level(image[inside]) for mode, image in images.items()}
    assert white_levels(images, inside, "individual") == own
    assert set(white_levels(images, inside, "shared").values()) == {own[Mode.LS]}
    paper = white_levels(images, inside, "0.01 % saturated")
    assert paper[Mode.ELSA] == paper[Mode.ELS] == own[Mode.ELS]
    assert paper[Mode.LS] == own[Mode.LS]


def test_a_profile_of_a_ramp_is_the_ramp_and_knows_its_length():
    ramp = np.tile(np.arange(50, dtype=np.float32), (50, 1))
    found = line_profiles({Mode.LS: ramp, Mode.ELS: 2 * ramp}, (25, 10), (25, 40), um_per_px=0.5)
    np.testing.assert_allclose(found.values[Mode.LS], np.arange(10, 41))
    np.testing.assert_allclose(found.values[Mode.ELS], 2 * np.arange(10, 41))
    np.testing.assert_allclose(found.position, 0.5 * np.arange(31))
    assert found.unit == "um"


@pytest.mark.parametrize(("start", "end"), [((5, 5), (5, 5.5)), ((60, 60), (70, 70)), ((-9, -9), (-2, -3))])
def test_lines_that_give_no_profile_are_refused(start, end):
    with pytest.raises(InputError):
        line_profiles({Mode.LS: np.zeros((50, 50), np.float32)}, start, end)


def test_the_script_runs_and_says_what_the_panel_says(tmp_path, capsys):
    path = write_pair(tmp_path)
    with open_recording(path) as recording:
        of_file = Stack.of(recording)
        script = comparison_script(of_file, str(tmp_path / "scan.calibration.json"), "median", "shared", 2)
    exec(script, {})
    said = capsys.readouterr().out
    assert [line.split(":")[0] for line in said.splitlines()] == ["ls", "elsa", "els"]
    with pytest.raises(InputError, match="has no file"):
        comparison_script(stack(), "c.json", "none", "shared", 0)
    with pytest.raises(CalibrationError, match="no file of its own"):
        comparison_script(of_file, "", "none", "shared", 0)
