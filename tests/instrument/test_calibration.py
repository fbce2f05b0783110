from __future__ import annotations

import json
import pickle
from typing import Any

import numpy as np
import pytest

from napari_elsplus.errors import CalibrationError
from napari_elsplus.instrument.calibration import VERSION, AcquiredWith, Calibration, FrameSection
from napari_elsplus.instrument.staleness import stale_sections

IMPOSSIBLE = [0.0, -1.3, float("nan"), float("inf")]
RECORD: dict[str, Any] = {
    "format": "napari-elsplus/calibration",
    "version": 1,
    "created": "2026-01-31T12:00:00Z",
    "frame": {"shape": [320, 640], "sensor_origin": [0, 0]},
    "acquired_with": {"rig": "simulated", "objective": "10x", "slit_rows": 3, "frame_rate_hz": 240.0, "gain_db": 0.0},
    "offset": {"rows": -12.03, "uncertainty_rows": 0.01, "tilt_deg": 0.2},
    "galvo": {
        "volts_per_row": 0.00126,
        "volts_at_row_zero": -0.459,
        "r_squared": 0.9999,
        "rms_rows": 0.05,
        "lag_s": 2e-4,
        "park_v": -0.7,
    },
    "bundle": {
        "confocal_centre": [161.0, 158.0],
        "residual_centre": [149.0, 481.0],
        "diameter_px": 290.0,
        "residual_to_confocal": [[1.0, 0.0, 12.0], [0.0, 1.0, -323.0]],
        "residual_gain": 1.0,
        "residual_gain_uncertainty": 0.003,
    },
    "optics": {"um_per_px": 2.138, "line_period_s": 7.648e-06, "rows_per_frame": 544.8},
    "quality": {"alignment_error": 0.012, "alignment_error_filtered": 0.004},
}


def changed(section: str, **values: object) -> dict[str, Any]:
    return RECORD | {section: RECORD[section] | values}


def test_content_survives_unchanged() -> None:
    assert json.loads(json.dumps(Calibration.parse(RECORD).content())) == RECORD


def test_unknown_keys_survive() -> None:
    record = changed("galvo", operator="A.T.") | {"site": "Kent"}
    assert Calibration.parse(record).content() == record


def test_unmeasured_sections_are_absent_and_asked_for() -> None:
    calibration = Calibration.parse({"offset": RECORD["offset"]})
    assert "galvo" not in calibration.content()
    with pytest.raises(CalibrationError, match=r"no galvo section.*--sweep"):
        calibration.require("offset", "galvo")


@pytest.mark.parametrize(
    ("record", "word"),
    [
        ([], "no napari-elsplus/calibration"),
        ({"format": "other"}, "no napari-elsplus/calibration"),
        ({"other": 1}, "no napari-elsplus/calibration"),
        ({"version": 1, "created": "2026-01-01T00:00:00Z"}, "no napari-elsplus/calibration"),
        (RECORD | {"version": VERSION + 1}, f"version {VERSION + 1}"),
        (RECORD | {"version": "new"}, "new"),
        (changed("bundle", confocal_centre=[float("nan"), 1]), "confocal_centre"),
        (changed("bundle", diameter_px=-4), "-4"),
        (changed("bundle", residual_gain=2.5), "2.5"),
        (changed("bundle", residual_to_confocal=[[1, 0, 900], [0, 1, -323]]), "888 px away"),
        (changed("bundle", residual_to_confocal=[[0, 0, 12], [0, 0, -323]]), "no map"),
        (changed("galvo", volts_per_row=0), "volts_per_row is 0"),
        (changed("optics", line_period_s=float("inf")), "line_period_s"),
        (changed("frame", shape=[0, 640]), "frame.shape"),
    ],
)
def test_broken_records_give_one_clear_line(record: object, word: str) -> None:
    with pytest.raises(CalibrationError, match=word) as caught:
        Calibration.parse(record)
    assert len(str(caught.value).splitlines()) == 1


def test_what_went_stale_is_said_with_the_reason() -> None:
    calibration = Calibration.parse(RECORD)
    assert stale_sections(calibration, AcquiredWith(objective="10x", slit_rows=3)) == {}
    stale = stale_sections(calibration, AcquiredWith(objective="4x"))
    assert set(stale) == {"offset", "galvo", "bundle", "optics"}
    assert stale["galvo"] == "objective changed from 10x to 4x"
    assert "bundle" in stale_sections(calibration, AcquiredWith(), FrameSection(shape=(100, 100)))


def test_sections_that_were_not_measured_are_not_stale() -> None:
    from_files = Calibration.parse({name: RECORD[name] for name in ("frame", "bundle")})
    assert set(stale_sections(from_files, AcquiredWith(), FrameSection(shape=(100, 100)))) == {"bundle"}


def test_rows_and_volts_are_inverse() -> None:
    galvo = Calibration.parse(RECORD).galvo
    assert galvo is not None
    assert galvo.row(galvo.volts(123.4)) == pytest.approx(123.4)


def test_scale_and_frame_period_are_given_only_where_they_are_known() -> None:
    known = Calibration.parse(RECORD)
    assert known.um_per_px == 2.138
    assert known.frame_period_s == pytest.approx(1 / 240, rel=1e-4)
    assert Calibration.parse(changed("optics", rows_per_frame=None)).frame_period_s is None
    bare = Calibration()
    assert bare.um_per_px is None
    assert bare.frame_period_s is None


def test_copies_are_equal_with_their_arrays() -> None:
    background = np.arange(6, dtype=np.float32).reshape(2, 3)
    one = Calibration(background=background, created="2026-01-31T12:00:00Z")
    assert one == pickle.loads(pickle.dumps(one))
    assert one != one.model_copy(update={"background": background + 1})
    assert one != one.model_copy(update={"background": None})
    assert one != one.model_copy(update={"flat": background})
    assert one != "calibration"


@pytest.mark.parametrize("absent", [{}, {"lag_s": 0.0}])
def test_a_scan_lag_that_was_not_measured_is_absent_and_not_zero(absent):
    galvo = {"volts_per_row": 1e-3, "volts_at_row_zero": 0.0, "r_squared": 1.0, "rms_rows": 0.0, **absent}
    calibration = Calibration.parse({"galvo": galvo})
    assert calibration.galvo.lag_s is None
    assert "lag_s" not in calibration.content()["galvo"]


@pytest.mark.parametrize("um_per_px", IMPOSSIBLE)
def test_optics_that_could_not_be_read_again_are_not_taken(um_per_px: float) -> None:
    """Before: such a scale was kept, and the file that was saved with it refused."""
    calibration = Calibration.parse(RECORD)
    with pytest.raises(CalibrationError, match="um_per_px"):
        calibration.with_optics(um_per_px=um_per_px)
    changed = calibration.with_optics(um_per_px=2.5)
    assert changed.um_per_px == 2.5
    assert changed.optics.line_period_s == calibration.optics.line_period_s
    assert calibration.with_optics(um_per_px=None).um_per_px is None


def test_the_residual_disc_has_the_size_of_its_own_view() -> None:
    """Light beyond a smaller one was taken for darkness beside the views."""
    record = RECORD["bundle"] | {"residual_to_confocal": [[0.97, 0.0, 16.47], [0.0, 0.97, -308.57]]}
    bundle = Calibration.parse(RECORD | {"bundle": record}).measured_bundle
    assert bundle.discs[0] == ((161.0, 158.0), 290.0)
    assert bundle.discs[1][1] == pytest.approx(290.0 / 0.97)
