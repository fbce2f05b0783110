"""The virtual card in another process: each call gets its own answer."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NoReturn

import pytest

from napari_elsplus.errors import DeviceError
from napari_elsplus.hardware.virtual.card.process import RemoteCard, start_card


@pytest.fixture
def card() -> Iterator[RemoteCard]:
    with start_card() as card:
        yield card


def fail(*_: object, **__: object) -> NoReturn:
    raise KeyboardInterrupt


def interrupt_a_call(card: RemoteCard, monkeypatch: pytest.MonkeyPatch, place: str = "_wire.recv") -> None:
    owner, _, name = place.rpartition(".")
    with monkeypatch.context() as patched:
        patched.setattr(card._wire if owner else card, name, fail)
        with pytest.raises(KeyboardInterrupt):
            card.programs()


@pytest.mark.parametrize("place", ["_wire.recv", "_wire._recv"])
def test_a_call_after_one_that_was_interrupted_gets_its_own_answer(card, monkeypatch, place) -> None:
    """Before: each call got the answer to the one before, or what was left of it, from then on."""
    volts = card.last_volts
    for _ in range(2):
        interrupt_a_call(card, monkeypatch, place)
        assert card.last_volts == volts
        assert card.laser_on is False
        assert card.programs()


def test_a_call_whose_connection_is_interrupted_anew_gets_its_own_answer(card, monkeypatch) -> None:
    volts = card.last_volts
    interrupt_a_call(card, monkeypatch)
    interrupt_a_call(card, monkeypatch, "_connect")
    assert card.last_volts == volts


def test_a_card_that_was_closed_after_an_interruption_stays_closed(card, monkeypatch) -> None:
    interrupt_a_call(card, monkeypatch)
    card.close()
    for _ in range(2):
        with pytest.raises(DeviceError, match="has ended"):
            card.programs()
