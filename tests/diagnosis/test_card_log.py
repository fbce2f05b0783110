"""The judge of parking, on a card's output that is given: a line that only flies back is not parked."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from napari_elsplus.diagnosis.rehearsal import card_log
from napari_elsplus.hardware.virtual.timeline import Program, StrobeTrain
from napari_elsplus.simulation.model.instrument import Instrument

if TYPE_CHECKING:
    from collections.abc import Iterator

INSTRUMENT = Instrument.of("240hz")
PERIOD_S = 1 / 240
SAMPLES = 200


class StandingLog:
    """Stands for the card's process: its output is known from the start."""

    def __init__(self, programs: list[Program]) -> None:
        self._programs = programs

    def programs(self) -> list[Program]:
        return self._programs

    def close(self) -> None:
        pass


def volts(rows: object) -> np.ndarray:
    """Drive of rows counted from the centre of the confocal view."""
    at = INSTRUMENT.confocal_centre[0] + np.asarray(rows, dtype=float)
    return INSTRUMENT.volts_at_row_zero + at * INSTRUMENT.volts_per_row


def scan(begin_s: float) -> Program:
    """Half of every frame over the disc, half of it clear of it."""
    radius = INSTRUMENT.diameter_px / 2
    rows = np.concatenate([np.linspace(-radius, radius, SAMPLES // 2), np.full(SAMPLES // 2, -3 * radius)])
    return Program(begin_s, float(volts(0)), volts(rows), SAMPLES, SAMPLES / PERIOD_S, StrobeTrain(begin_s, PERIOD_S))


@pytest.fixture
def log(monkeypatch: pytest.MonkeyPatch) -> Iterator[card_log.CardLog]:
    programs = [scan(0.0), Program(2.0, float(volts(-3 * INSTRUMENT.diameter_px)))]  # parked at 2 s
    monkeypatch.setattr(card_log, "RemoteCard", lambda _: StandingLog(programs))
    with card_log.CardLog({}, INSTRUMENT) as log:
        yield log


@pytest.mark.parametrize("phase", np.linspace(0, 1, 9))
def test_a_line_in_its_flyback_is_not_parked(log: card_log.CardLog, phase: float) -> None:
    assert log.clear_after_s(0.5, 1.5 + phase * PERIOD_S) is None


@pytest.mark.parametrize("phase", np.linspace(0, 1, 9))
def test_a_line_that_was_parked_is_off_from_its_last_crossing_on(log: card_log.CardLog, phase: float) -> None:
    assert log.clear_after_s(1.5, 2.5 + phase * PERIOD_S) == pytest.approx(0.5, abs=1.5 * PERIOD_S)
    assert log.clear_after_s(2.1, 2.5) == 0.0
