"""Scans of depths: one answer from a stack, by hand and in a script; drop-offs follow the slit offset."""

from __future__ import annotations

import numpy as np
import pytest

from depth_scan import DEPTH_UM, calibration, frames
from napari_elsplus.errors import CalibrationError, InputError
from napari_elsplus.instrument.calibration import Calibration
from napari_elsplus.io import open_recording, write_calibration, write_column, write_images
from napari_elsplus.processing.axial.axial_response import axial_response
from napari_elsplus.viewing.axial import (
    ManualScan,
    Scan,
    axial_script,
    drop_offs,
    measure_scan,
    simulated_scan,
    slit_um,
)
from napari_elsplus.viewing.lazy import LazyPlanes
from napari_elsplus.viewing.stack import Stack


def stack():
    raw = frames()
    return Stack("plate", LazyPlanes(raw.__getitem__, raw.shape, raw.dtype), depth_um=DEPTH_UM)


def test_a_stack_and_frames_taken_by_hand_in_any_order_agree():
    seen = []
    measured = measure_scan(stack(), calibration(), progress=lambda numbers: (seen.append(k) or k for k in numbers))
    assert seen == list(range(len(DEPTH_UM)))
    by_hand = ManualScan()
    for k in (3, 0, 1, 8, 2, 7, 6, 5, 4):
        by_hand.take(frames()[k], calibration(), DEPTH_UM[k])
    taken = by_hand.scan(calibration())
    assert taken.response.content() == measured.response.content()
    assert measured.response.els_3db.um == pytest.approx(30, rel=0.02)
    assert (measured.offset_um, measured.slit_um) == slit_um(calibration()) == (20.0, 4.0)
    assert measured.content()["els"]["drop_3db_um"] == measured.response.els_3db.um


def test_too_few_depths_and_unknown_depths_are_refused():
    by_hand = ManualScan()
    by_hand.take(frames()[0], calibration(), 0)
    with pytest.raises(InputError, match="1 different depths"):
        by_hand.scan(calibration())
    with pytest.raises(InputError, match=r"depths\.csv"):
        measure_scan(Stack("bare", stack().planes), calibration())


def scan(offset_um, reach_um):
    depth = np.arange(0.0, 600, 2)
    ls, els = 1 / (1 + depth / 60), 1 / (1 + (depth / reach_um) ** 2)
    return Scan(f"{offset_um}", axial_response(depth, ls, ls - els), offset_um, 2.9)


def test_drop_offs_against_the_offset_get_the_papers_curve():
    offsets = np.array([77.0, 12, 29, 40, 58])
    scans = [scan(offset, 58 * (1 - np.exp(-0.032 * offset))) for offset in offsets]
    found = drop_offs(scans, "slit offset")
    np.testing.assert_array_equal(found.x_um, np.sort(offsets))
    assert found.fit_3db.limit_um == pytest.approx(58, rel=0.02)
    assert found.fit_3db.rate_per_um == pytest.approx(0.032, rel=0.03)
    assert drop_offs(scans[:2], "slit offset").fit_3db is None
    assert drop_offs(scans, "slit width").fit_3db is None


def test_scans_of_unknown_slits_are_refused():
    bare = Scan("bare", scan(29.0, 35).response, None, None)
    with pytest.raises(InputError, match="slit offset is known"):
        drop_offs([bare], "slit offset")
    assert slit_um(Calibration()) == (None, None)


def test_a_simulated_scan_has_the_offset_that_was_asked_for():
    simulated, known = simulated_scan(77.0, 2.9, depth_um=np.array([0.0, 30, 60]))
    measured = measure_scan(simulated, known)
    assert measured.offset_um == pytest.approx(77, abs=0.5)
    assert measured.response.signal_kept > 0.95


def test_the_script_runs_and_says_the_same(tmp_path, capsys):
    write_images(tmp_path / "scan.tif", frames())
    write_column(tmp_path / "scan.depths.csv", "depth_um", DEPTH_UM)
    beside = write_calibration(tmp_path / "scan.calibration.json", calibration())
    with open_recording(tmp_path / "scan.tif") as recording:
        of_file = Stack.of(recording)
        measured = measure_scan(of_file, calibration())
        script = axial_script(of_file, str(beside))
        with pytest.raises(CalibrationError):
            axial_script(of_file, "")
    exec(script, {})
    said = capsys.readouterr().out
    assert f"ELS+: 3 dB at {measured.response.els_3db.um:.1f} um" in said
    with pytest.raises(InputError, match="has no file"):
        axial_script(stack(), "c.json")


def test_depths_that_do_not_fit_the_frames_are_refused(tmp_path):
    write_images(tmp_path / "scan.tif", frames())
    write_column(tmp_path / "scan.depths.csv", "depth_um", DEPTH_UM[:-1])
    with open_recording(tmp_path / "scan.tif") as recording, pytest.raises(InputError, match="8 depths"):
        Stack.of(recording)
