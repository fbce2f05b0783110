"""ELSA's frames know their ramp, whatever is lost on the way."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from napari_elsplus.errors import InputError
from napari_elsplus.hardware.daq import DaqScanner
from napari_elsplus.hardware.parity import REMEMBERS, RampParity
from napari_elsplus.hardware.protocols import Region
from napari_elsplus.hardware.waveform import MirrorLimits, ScanTiming, elsa_waveform


@settings(deadline=None)
@given(
    lost_frames=st.sets(st.integers(1, 199), max_size=60),
    missed_strobe=st.integers(60, 140),
    late=st.lists(st.integers(0, 5), min_size=200, max_size=200),
)
def test_once_a_frame_was_read_in_time_lost_frames_and_late_reading_do_not_matter(
    lost_frames, missed_strobe, late
) -> None:
    parity = RampParity()
    on_time: int | None = None
    reads_since = 0
    for frame in range(200):
        if frame in lost_frames:
            continue
        begun = frame + 1 - (frame >= missed_strobe)
        reads_since += 1
        if late[frame] == 0:
            on_time, reads_since = frame, 0
        got = parity.ramp_of(frame, begun + late[frame])
        known = on_time is not None and reads_since < REMEMBERS
        if known and (on_time >= missed_strobe) == (frame >= missed_strobe):
            assert got == (begun - 1) % 2


def test_a_false_edge_is_forgotten_after_a_while() -> None:
    parity = RampParity()
    for frame in range(40):
        parity.ramp_of(frame, frame + 1)
    got = [parity.ramp_of(frame, frame + 2) for frame in range(40, 120)]
    assert got[REMEMBERS:] == [(frame + 1) % 2 for frame in range(40, 120)][REMEMBERS:]


def test_a_frame_before_any_ramp_has_no_parity() -> None:
    with pytest.raises(InputError, match="before any ramp"):
        RampParity().ramp_of(0, 0)


def test_through_both_drivers_every_frame_is_given_the_ramp_that_the_card_put_out(cards, cameras, calibration) -> None:
    """A strobe is missed on the way; the ramp that was out is known from the voltage itself."""
    card, camera_bench = cards(), cameras()
    camera_bench.bench.strobe = card.card.strobe
    with camera_bench.open() as camera, DaqScanner(card.settings, card.limits) as scanner:
        camera.configure(Region(262, 0, 524, 64), slit_rows=3, frame_rate_hz=25)  # slow enough to read in time
        timing = ScanTiming(camera.line_period_s, camera.rows_per_frame, 3)
        waveform = elsa_waveform(calibration(), timing, MirrorLimits())
        both = waveform.volts.reshape(2, -1)
        scanner.scan(waveform)
        camera.start()
        buffer = np.empty(camera.frame_shape, np.uint8)
        parity, right, ramps = RampParity(), 0, []
        for k in range(30):
            info = camera.read_into(buffer, 2.0)
            ramp = parity.ramp_of(info.frame_number, scanner.ramps_begun)
            ramps.append(ramp)
            if k == 14:
                camera_bench.plug.camera.miss_strobe()
            strobe_s = info.exposed_s - 3 * camera.line_period_s
            out = [program.volts(np.array([strobe_s + 0.003]))[0] for program in card.card.programs()][-1]
            right += abs(both[ramp][int(0.003 * waveform.sample_rate_hz)] - out) < 1e-3
        assert right >= 28  # the frame whose strobe was missed has the ramp before
        assert [a == b for a, b in pairwise(ramps)].count(True) == 1
