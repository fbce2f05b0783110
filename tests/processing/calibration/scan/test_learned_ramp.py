"""The ramp learned from the camera, on galvos that no rig file describes, against a model that is stepped in time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import product

import numpy as np
import pytest

from napari_elsplus.errors import InputError
from napari_elsplus.hardware.scan.waveform import GalvoLimits, els_waveform
from napari_elsplus.instrument.calibration import AcquiredWith, Calibration
from napari_elsplus.instrument.scanning import rate_advice
from napari_elsplus.instrument.staleness import stale_sections
from napari_elsplus.io import read_calibration, write_calibration
from napari_elsplus.processing.calibration.draft import Draft
from napari_elsplus.processing.calibration.scan.lag import ScanLag
from napari_elsplus.processing.calibration.scan.measure import measure_scan
from napari_elsplus.processing.calibration.steps import LAG
from processing.calibration.scan.plain_scans import SLIT_ROWS, PlainScans

QUARTER_SLIT = SLIT_ROWS / 4
MIRRORS = list(product((500.0, 700.0, 900.0, 1200.0, 1600.0, 2000.0), (0.3, 0.5, 0.7, 1.0), (0.0, 1e-4)))


def accepted(rig: PlainScans, found: ScanLag) -> Calibration:
    return LAG.accept(Draft(rig.calibration), found, rig.setup).calibration


def assert_on_the_slit(rig: PlainScans, known: Calibration) -> None:
    assert np.abs(rig.errors(known)).max() <= QUARTER_SLIT
    assert rig.signal(known) >= 0.99


def test_a_galvo_that_nobody_described_scans_with_every_row_on_the_slit() -> None:
    rig = PlainScans(natural_hz=800.0, damping=0.5, delay_s=6e-5, cubic_rows=2.0)
    found = measure_scan(rig, rig.calibration, rig.setup, 1)
    scalar = rig.calibration.galvo.model_copy(update={"lag_s": found.lag_s})
    assert rig.signal(rig.calibration.model_copy(update={"galvo": scalar})) < 0.9
    known = accepted(rig, found)
    assert_on_the_slit(rig, known)
    assert known.galvo.lag_s == pytest.approx(6e-5 + 0.5 / (np.pi * 800), abs=3e-6)
    summary = LAG.summary(Draft(rig.calibration), found, rig.setup)
    assert not summary.warnings
    assert any("ramp learned" in line for line in summary.lines)
    assert rig.taken * rig.timing.frame_period_s < 2.0


def test_a_galvo_as_described_is_left_alone_and_costs_no_more_frames() -> None:
    rig = PlainScans(natural_hz=1000.0, damping=0.7, limits=GalvoLimits(natural_hz=1000.0, damping=0.7))
    found = measure_scan(rig, rig.calibration, rig.setup, 1)
    assert rig.taken == len(found.leads_s)
    assert found.ramp is None
    assert found.row_errors.largest_rows < QUARTER_SLIT
    known = accepted(rig, found)
    assert known.scan_correction is None
    assert known.galvo.natural_hz is None
    assert_on_the_slit(rig, known)


def test_a_bowed_line_is_centred_by_its_middle() -> None:
    """Of a bow of 2 rows at the rim, the mean over the middles of chords is 0.125; sectioning counts in the middle."""
    described = {"natural_hz": 1000.0, "damping": 0.7, "limits": GalvoLimits(natural_hz=1000.0, damping=0.7)}
    straight, bowed = PlainScans(**described), PlainScans(**described)
    galvo = bowed.calibration.galvo.model_copy(update={"bow_rows": 2.0})
    bowed.calibration = bowed.calibration.model_copy(update={"galvo": galvo})
    lags = [measure_scan(rig, rig.calibration, rig.setup, 1).lag_s for rig in (straight, bowed)]
    assert (lags[0] - lags[1]) / straight.timing.line_period_s == pytest.approx(-0.125)


def test_a_wrong_rig_file_is_corrected() -> None:
    rig = PlainScans(natural_hz=800.0, damping=0.7, limits=GalvoLimits(natural_hz=1000.0, damping=0.7))
    assert_on_the_slit(rig, accepted(rig, measure_scan(rig, rig.calibration, rig.setup, 1)))


def test_a_galvo_that_is_too_slow_is_reported_with_the_rate_that_it_could_follow() -> None:
    rig = PlainScans(natural_hz=500.0, damping=0.7)
    found = measure_scan(rig, rig.calibration, rig.setup, 1)
    assert found.ramp is not None
    assert found.ramp.highest_rate_hz == pytest.approx(232, abs=3)
    (warning,) = LAG.summary(Draft(rig.calibration), found, rig.setup).warnings
    assert "frames per second fit" in warning
    calibration = accepted(rig, found)
    assert calibration.scan_correction is None
    assert f"choose {found.ramp.highest_rate_hz:.0f} frames per second or fewer" in rate_advice(calibration)
    quick = PlainScans(natural_hz=1000.0, damping=0.7)
    quick.calibration = calibration
    assert not rate_advice(accepted(quick, measure_scan(quick, calibration, quick.setup, 1)))


def test_shifts_beyond_the_galvos_range_are_left_out() -> None:
    """The ramp of a slow galvo fits into its range, but not the lowest of the shifts that show its row errors."""
    rig = PlainScans(natural_hz=700.0, damping=0.7)
    free = accepted(rig, measure_scan(rig, rig.calibration, rig.setup, 1))
    lowest_v = float(els_waveform(free, rig.timing, rig.limits).volts.min())
    tight = PlainScans(natural_hz=700.0, damping=0.7, limits=GalvoLimits(min_v=lowest_v - 0.03))
    found = measure_scan(tight, tight.calibration, tight.setup, 1)
    assert tight.taken < rig.taken
    assert_on_the_slit(tight, accepted(tight, found))


def test_a_ramp_that_fits_without_any_shift_is_reported_with_the_rate_at_which_it_can_be_measured() -> None:
    """The rows of a better ramp were all unknown, the old one was kept, and a lower rate advised without a number."""
    limits = GalvoLimits(min_v=-1.7945)  # the first corrected ramp turns at -1.7939 V, a shift is 0.0019 V
    tight = PlainScans(natural_hz=700.0, damping=0.7, limits=limits)
    found = measure_scan(tight, tight.calibration, tight.setup, 1)
    assert found.ramp is not None
    assert found.ramp.highest_rate_hz is not None
    assert 225 <= found.ramp.highest_rate_hz < 240
    rate_hz = float(np.floor(found.ramp.highest_rate_hz))
    slower = PlainScans(natural_hz=700.0, damping=0.7, limits=limits, rate_hz=rate_hz)
    assert_on_the_slit(slower, accepted(slower, measure_scan(slower, slower.calibration, slower.setup, 1)))


def test_learning_can_be_cancelled() -> None:
    rig = PlainScans(natural_hz=800.0, damping=0.5)

    def impatient(numbers: Iterable[int]) -> Iterator[int]:
        for number in numbers:
            if rig.taken > 60:
                raise InputError("the scan lag was cancelled", "start it again")
            yield number

    with pytest.raises(InputError, match="cancelled"):
        measure_scan(rig, rig.calibration, rig.setup, 1, impatient)
    assert rig.taken < 63


def test_a_learned_ramp_is_kept_in_files_and_stale_at_another_rate(tmp_path) -> None:
    rig = PlainScans(natural_hz=1500.0, damping=0.4)
    known = accepted(rig, measure_scan(rig, rig.calibration, rig.setup, 1))
    read = read_calibration(write_calibration(tmp_path / "known.json", known))
    assert read == known
    assert read.version == 1
    assert_on_the_slit(rig, read)
    draft = Draft(known)
    now = AcquiredWith(frame_rate_hz=200.0)
    then = known.model_copy(update={"acquired_with": AcquiredWith(frame_rate_hz=240.0)})
    assert "scan_correction" in stale_sections(then, now)
    assert LAG.state(draft, rig.setup)[0] == "done"


def test_a_correction_of_another_frame_is_refused(tmp_path) -> None:
    known = PlainScans().calibration
    path = write_calibration(
        tmp_path / "known.json", known.model_copy(update={"scan_correction": np.zeros(7, np.float32)})
    )
    with pytest.raises(Exception, match="the scan correction has 7 rows"):
        read_calibration(path)


@pytest.mark.slow
@pytest.mark.parametrize("preset", ["240hz", "120hz"])
def test_mirrors_of_500_to_2000_hz_scan_on_the_slit_or_are_refused_with_a_rate(preset: str) -> None:
    """At 240 Hz and +-2 V those of 500 and 700 Hz may be too slow: then a rate that fits is reported."""
    slow = []
    for seed, (natural_hz, damping, delay_s) in enumerate(MIRRORS):
        rig = PlainScans(preset, natural_hz, damping, delay_s, cubic_rows=2.0, seed=seed)
        found = measure_scan(rig, rig.calibration, rig.setup, 1)
        if found.ramp is not None and found.ramp.highest_rate_hz is not None:
            slow.append(natural_hz)
            assert 220 <= found.ramp.highest_rate_hz < 240
            continue
        assert_on_the_slit(rig, accepted(rig, found))
    assert set(slow) <= ({500.0, 700.0} if preset == "240hz" else set())
