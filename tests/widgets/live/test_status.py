"""What the Live panel says of the stream."""

from __future__ import annotations

from napari_elsplus.acquisition.engine.status import Status
from napari_elsplus.instrument.calibration import Calibration
from napari_elsplus.widgets.live.status import status_text

GALVO = {"volts_per_row": 1e-3, "volts_at_row_zero": 0.0, "r_squared": 1.0, "rms_rows": 0.0}
ADVICE = "Scan lag not measured"


def test_a_scan_whose_lag_is_unknown_comes_with_advice():
    late = Calibration.parse({"galvo": {**GALVO, "lag_s": 2e-4}})
    unknown = Calibration.parse({"galvo": GALVO})
    scanning, at_rest = Status(live=True, scanning=True), Status(live=True)
    assert ADVICE in status_text(scanning, unknown, 30.0, busy=False)
    assert ADVICE not in status_text(at_rest, unknown, 30.0, busy=False)
    for known in (late, None):
        assert ADVICE not in status_text(scanning, known, 30.0, busy=False)


def test_what_does_not_hold_any_more_is_said_with_its_reason():
    status = Status(live=True, stale={"background": "gain_db was 0.0, is 6.0"})
    assert "stale: background (gain_db was 0.0, is 6.0)" in status_text(status, None, 30.0, busy=False)
