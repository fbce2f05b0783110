"""The speed bar and the text below it, without an engine."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from napari_elsplus.acquisition.engine.status import Status
from napari_elsplus.hardware.parking import ParkStage, ParkState
from napari_elsplus.viewing.mosaic.track import Speed, probe_speed
from napari_elsplus.widgets.mosaic.speed_bar import SpeedBar
from napari_elsplus.widgets.mosaic.status import track_text


@pytest.mark.parametrize(
    ("speed", "growing", "text"),
    [
        (probe_speed([], 100.0), True, "not measured yet"),  # before: a track of no frames was being lost
        (Speed(max_px_per_frame=100.0, tracked=0.2), True, "Track is being lost"),
        (Speed(max_px_per_frame=100.0, tracked=0.2), False, "not measured yet"),
        (Speed(5.0, 100.0, tracked=0.2), False, "speed 5 px/frame"),
    ],
)
def test_a_track_is_being_lost_only_while_it_grows(qtbot, speed, growing, text):
    bar = SpeedBar("dark")
    qtbot.addWidget(bar)
    bar.show_speed(speed, growing=growing)
    assert text in bar.text


def test_a_galvo_that_was_parked_is_the_reason_why_frames_are_lost():
    track = SimpleNamespace(running=True, loop_closures=3, rerenders=True)
    parked = Status(live=True, track=track, park_state=ParkState(ParkStage.PARKED))
    assert "the galvo is parked: frames are dark" in track_text(parked, None)
    driven = Status(live=True, track=track, park_state=ParkState(ParkStage.DRIVEN))
    assert "parked" not in track_text(driven, None)
