"""The calibration step of examples/extending, added from outside the package, is in panel, command line and engine."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import tifffile

import napari_elsplus as elsplus
from napari_elsplus.acquisition.engine.status import Settings
from napari_elsplus.acquisition.link.client import EngineClient
from napari_elsplus.instrument.calibration import AcquiredWith, FrameSection
from napari_elsplus.processing.calibration.draft import Draft, Setup
from napari_elsplus.processing.calibration.step import REGISTERED, StepState
from napari_elsplus.processing.calibration.steps import calibration_steps, find_step
from steps_table import steps_table

pytestmark = pytest.mark.checkout

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "extending"
KEY, NOISE_DN = "read_noise", 2.5


@pytest.fixture
def added(monkeypatch, tmp_path):
    """The step is registered here, and importable in the engine's process."""
    monkeypatch.syspath_prepend(str(EXAMPLE))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(EXAMPLE), os.environ.get("PYTHONPATH", "")]))
    before = dict(REGISTERED)
    sys.modules.pop("calibration_step", None)
    import calibration_step

    yield calibration_step.READ_NOISE
    REGISTERED.clear()
    REGISTERED.update(before)


@pytest.fixture
def dark(tmp_path) -> Path:
    frames = np.random.default_rng(0).normal(30, NOISE_DN, (20, 40, 60)).round().astype(np.uint8)
    tifffile.imwrite(tmp_path / "dark.tif", frames, photometric="minisblack")
    return tmp_path / "dark.tif"


def test_it_is_the_last_step_measured_from_a_file_and_kept_by_the_calibration(added, dark, tmp_path):
    assert calibration_steps()[-1] is added is find_step(KEY)
    assert "| 7 read noise | Probe in the dark tube. |" in steps_table()
    draft = elsplus.calibrate(dark=dark)
    found = draft.found[KEY]
    assert found.sigma_dn == pytest.approx(np.hypot(NOISE_DN, 12**-0.5), abs=4 * found.uncertainty_dn)
    elsplus.save_calibration(tmp_path / "cal.json", draft.calibration)
    again = Draft(elsplus.load_calibration(tmp_path / "cal.json"))
    assert again.calibration.read_noise["sigma_dn"] == found.sigma_dn
    assert added.state(again)[0] is StepState.DONE
    assert "grey levels" in added.summary(draft, found, Setup(FrameSection(shape=(40, 60)))).headline


def test_it_is_stale_at_another_gain(added, dark):
    setup = Setup(FrameSection(shape=(40, 60)), AcquiredWith(gain_db=0.0))
    draft = added.accept(Draft(), elsplus.calibrate(dark=dark).found[KEY], setup)
    assert added.state(draft, setup)[0] is StepState.DONE
    louder = Setup(setup.frame, AcquiredWith(gain_db=6.0))
    assert added.state(draft, louder) == (StepState.STALE, "gain changed from 0 to 6 dB")


def test_the_engine_measures_it_in_its_own_process(added):
    with EngineClient() as client:
        client.open("simulated").result(60)
        client.configure(Settings("240hz")).result(60)
        found = client.measure_step(find_step(KEY), Draft()).result()
    assert found.frames == added.frames
    assert 0 < found.uncertainty_dn < found.sigma_dn < 10


def test_the_panel_lists_it_and_measures_it_from_a_file(added, dark, make_napari_viewer_proxy, qtbot):
    _, panel = make_napari_viewer_proxy().window.add_plugin_dock_widget("napari-elsplus", "Calibration")
    panel.form.steps[KEY].click()
    assert "read noise" in panel.form.steps[KEY].text()
    assert "dark tube" in panel.form.explanation.text()
    panel.measure_file(dark)
    qtbot.waitUntil(lambda: not panel.work.busy, timeout=30_000)
    assert "grey levels" in panel.form.headline.text()
    panel.form.accept.click()
    assert added.state(panel.draft)[0] is StepState.DONE


def test_an_installed_package_adds_its_option_to_the_command(dark, tmp_path):
    installed = tmp_path / "site" / "read_noise-1.dist-info"
    installed.mkdir(parents=True)
    (installed / "METADATA").write_text("Metadata-Version: 2.1\nName: read-noise\nVersion: 1\n")
    group = "[napari_elsplus.calibration_steps]\nread_noise = calibration_step:READ_NOISE\n"
    (installed / "entry_points.txt").write_text(group)
    path = os.pathsep.join([str(EXAMPLE), str(installed.parent), os.environ.get("PYTHONPATH", "")])
    out = tmp_path / "cal.json"
    main = "from napari_elsplus.cli import main; main()"
    command = [sys.executable, "-c", main, "calibrate", "--dark", str(dark), "-o", str(out)]
    ran = subprocess.run(command, capture_output=True, text=True, env=os.environ | {"PYTHONPATH": path}, check=False)
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout.startswith("read noise: 2.5")
    assert "+-" in ran.stdout
    assert elsplus.load_calibration(out).read_noise["sigma_dn"] == pytest.approx(NOISE_DN, abs=0.1)
