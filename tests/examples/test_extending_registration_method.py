"""The example of docs/extending-registration-method.md: a registration function from outside the package."""

from __future__ import annotations

import runpy
import subprocess
import sys
from math import hypot, pi, sqrt
from pathlib import Path

import numpy as np
import pytest

from napari_elsplus.errors import InputError
from napari_elsplus.processing.images.sectioning import Mode
from napari_elsplus.processing.tracking import registry
from napari_elsplus.processing.tracking.pairwise_tracking import PairwiseShift
from napari_elsplus.processing.tracking.registry import (
    Method,
    register_pairwise_method,
    register_tracking_method,
    tracking_method,
    tracking_methods,
)
from napari_elsplus.simulation.model.instrument import Instrument
from napari_elsplus.simulation.truth import true_calibration
from napari_elsplus.workflows.tracking import Pipeline

pytestmark = pytest.mark.checkout

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "extending" / "registration_method.py"
NAME = "phase-correlation"


@pytest.fixture(autouse=True)
def own_registry(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a test registers is known to it alone."""
    monkeypatch.setattr(registry, "_METHODS", dict(registry._METHODS))


@pytest.fixture
def example():
    found = runpy.run_path(str(EXAMPLE))
    found["register"]()
    return found


def test_the_example_tracks_a_moving_probe(example) -> None:
    assert example["main"](frames=12) < 6.0  # camera pixels; one pixel of the grid is two, over some 80 of motion


def test_its_shift_has_the_sign_that_is_documented(example) -> None:
    scene = np.random.default_rng(0).random((120, 120), np.float32) + 0.5
    fixed, moving = scene[20:100, 20:100], scene[23:103, 13:93]
    assert example["phase_correlation"](fixed, moving, (0.0, 0.0)).shift == (3.0, -7.0)


def test_a_frame_without_contrast_is_not_registered(example) -> None:
    blank = np.zeros((80, 80), np.float32)
    assert example["phase_correlation"](blank, blank, (0.0, 0.0)) is None


def test_an_installed_package_is_found_by_the_command_line(tmp_path: Path) -> None:
    """As pip would install it: a module beside its metadata, found in a process that was told nothing of it."""
    (tmp_path / "phase_example.py").write_text(EXAMPLE.read_text("utf-8"), "utf-8")
    metadata = tmp_path / "phase_example-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: phase-example\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text(
        f"[napari_elsplus.tracking_methods]\n{NAME} = phase_example:register\nabsent = no_such_module:register\n"
    )
    code = (
        f"import sys; sys.path.insert(0, {str(tmp_path)!r})\n"
        "from napari_elsplus.cli import main; main(['mosaic', '--help'])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert NAME in done.stdout
    assert "no_such_module" in done.stderr  # a broken one is named, and the others work


def test_frames_that_are_not_registered_are_predicted_then_lost_and_a_new_segment_follows() -> None:
    places = [1] * 4 + [0] * 7 + [2] * 3  # on tissue, lifted, on other tissue

    def register(fixed, moving, expected):
        alike = fixed.max() == moving.max() > 0
        return PairwiseShift((1.0, 0.0), np.diag([0.01, 0.04]), 0.9) if alike else None

    register_pairwise_method("steps", register, "a pixel a frame")
    instrument = Instrument.of("120hz")
    method = tracking_method("steps").factory(true_calibration(instrument), instrument.frame_shape, Mode.LS)
    image = np.ones((method.grid.side, method.grid.side), np.float32)
    poses = [method.estimate_pose(image * place) for place in places]
    assert "".join(pose.state[0] for pose in poses) == "tttt" + "ppppp" + "ll" + "ltt"
    assert [pose.segment for pose in poses[-2:]] == [1, 1]
    assert (poses[-2].row, poses[-2].col) == (0.0, 0.0)
    # That of the shift, and what uneven motion adds: white-noise acceleration moves the middle of a frame that is read
    # all the time by sqrt(1 / 160) of the velocity's spread, of which the first is the largest.
    assert 0.2 < poses[3].sigma < hypot(0.2, sqrt(1 / 160) * 1.2 * 2 / pi)


@pytest.mark.parametrize("bad", [PairwiseShift((np.nan, 0.0), np.eye(2)), PairwiseShift((0.0, 0.0), np.eye(3))])
def test_numbers_that_mean_nothing_are_refused(bad: PairwiseShift) -> None:
    register_pairwise_method("bad", lambda fixed, moving, expected: bad, "bad")
    instrument = Instrument.of("120hz")
    pipeline = Pipeline(true_calibration(instrument), instrument.frame_shape, method="bad")
    frame = np.zeros(instrument.frame_shape, np.uint8)
    pipeline.add(frame, 0)
    with pytest.raises(InputError, match="covariance"):
        pipeline.add(frame, 1)


def test_built_in_names_are_kept_and_unknown_ones_refused() -> None:
    assert list(tracking_methods())[:2] == list(Method)
    for name in ("elsplus", "", "two words"):
        with pytest.raises(InputError, match="cannot be called"):
            register_tracking_method(name, tracking_method("paper").factory, "mine")
    with pytest.raises(InputError, match="there is no tracking method 'none'"):
        tracking_method("none")
