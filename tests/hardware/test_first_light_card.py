"""The check of the card alone, on the virtual card."""

from __future__ import annotations

import time

from napari_elsplus.diagnosis import first_light_card
from napari_elsplus.hardware.daq.scanner import DaqScanner
from napari_elsplus.instrument.optics import PRESETS


def test_without_a_camera_the_cards_other_counter_starts_every_ramp(cards, monkeypatch) -> None:
    monkeypatch.setattr(first_light_card, "DRY_RUN_S", 0.3)
    bench = cards()
    said = list(first_light_card.dry_run(bench.settings, bench.limits))
    assert said[0] == "parked at -0.700 V; read back -0.700 V"
    assert [line.split(":")[0] for line in said[1::2]] == list(PRESETS)
    assert [line.split(",")[0] for line in said[2::2]] == ["one ramp for every pulse"] * len(PRESETS)
    driven = {volts for program in bench.card.programs() for volts in (*program.samples, program.resting_v)}
    assert driven == {0.0, -0.7}  # where it was switched on, and parked


def test_a_card_that_is_slow_to_answer_is_not_said_to_miss_pulses(cards, monkeypatch) -> None:
    """Before: on a busy computer ramps went on between the count and the time that was taken after it."""
    monkeypatch.setattr(first_light_card, "DRY_RUN_S", 0.1)
    bench = cards()
    count = DaqScanner.ramps_begun.fget

    def slow_to_answer(scanner: DaqScanner) -> int:
        begun = count(scanner)
        time.sleep(0.05)
        return begun

    monkeypatch.setattr(DaqScanner, "ramps_begun", property(slow_to_answer))
    said = list(first_light_card.dry_run(bench.settings, bench.limits))
    assert [line.split(",")[0] for line in said[2::2]] == ["one ramp for every pulse"] * len(PRESETS)


def test_a_card_that_misses_pulses_is_told(cards, monkeypatch) -> None:
    monkeypatch.setattr(first_light_card, "DRY_RUN_S", 0.3)
    bench = cards()
    count = DaqScanner.ramps_begun.fget
    monkeypatch.setattr(DaqScanner, "ramps_begun", property(lambda scanner: count(scanner) // 2))
    said = list(first_light_card.dry_run(bench.settings, bench.limits))
    assert [line.split(":")[0] for line in said[2::2]] == ["not every pulse starts a ramp"] * len(PRESETS)


def test_a_card_that_does_not_count_what_it_repeats_is_told(cards, monkeypatch) -> None:
    monkeypatch.setattr(first_light_card, "DRY_RUN_S", 0.05)
    bench = cards()
    monkeypatch.setattr(bench.card, "samples_done", lambda handle: 0)
    said = list(first_light_card.dry_run(bench.settings, bench.limits))
    assert all(line.startswith("the count of samples stands") for line in said[2::2])
