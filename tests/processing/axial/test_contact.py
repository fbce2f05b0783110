from __future__ import annotations

import numpy as np
import pytest

from napari_elsplus.processing.axial.axial_notes import axial_notes
from napari_elsplus.processing.axial.axial_response import AxialResponse, axial_response

BEYOND_UM = np.r_[np.arange(0, 60, 3.0), np.arange(60, 200, 10.0), np.arange(200, 700, 30.0)]
SLOW = (60.0, 540.0, 30.0, 90.0)


def slow(depth_um: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """LS and ELS+ that fall from contact on, as those of a bundle without a lens do; `SLOW` are its distances."""
    return 100 / (1 + depth_um / 60), 80 / (1 + np.square(depth_um / 30))


def flat(depth_um: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """LS and ELS+ that are level in contact, as those behind a lens are; both fall to a half at 40 um."""
    ls = 100 / (1 + np.square(depth_um / 40))
    return ls, 0.8 * ls


def responses(curves: object, pressed_um: np.ndarray, first_um: float, noise: float = 0.005) -> list[AxialResponse]:
    """Scans of a plate that is pressed at first, with a laser whose power differs from frame to frame."""
    depth = np.r_[-pressed_um, BEYOND_UM]
    found = []
    for seed in range(20):
        power = np.random.default_rng(9400 + seed).normal(1, noise, len(depth))
        ls, els = (power * each for each in curves(np.maximum(depth, 0)))  # type: ignore[operator]
        found.append(axial_response(depth - depth[0] + first_um, ls, ls - els))
    return found


def pulls(found: list[AxialResponse], truth: tuple[float, ...]) -> np.ndarray:
    names = ("ls_3db", "ls_10db", "els_3db", "els_10db")[: len(truth)]
    drops = [[getattr(each, name) for name in names] for each in found]
    return np.array([[(d.um - t) / d.uncertainty_um for d, t in zip(row, truth, strict=True)] for row in drops])


@pytest.mark.parametrize("first_um", [-12.0, 1234.5])
def test_contact_is_the_end_of_the_level_signals_of_a_plate_that_is_pressed(first_um: float) -> None:
    """It was any of the pressed depths: ELS+ 3 dB distances were off by 20 % and 30 standard deviations."""
    found = responses(slow, np.array([12.0, 8, 4, 1]), first_um)
    assert np.median(np.abs([each.contact_um - first_um - 12 for each in found])) <= 1
    assert np.sqrt(np.mean(np.square(pulls(found, SLOW)), axis=0)).max() < 2
    assert np.abs(pulls(found, SLOW)).max() < 4


def test_contact_of_a_plate_pressed_for_long_is_found_or_its_uncertainty_stated() -> None:
    found = responses(slow, np.arange(40.0, 0, -3), 77.0)
    assert np.median(np.abs([each.contact_um - 117 for each in found])) <= 3
    assert np.abs(pulls(found, SLOW)).max() < 4


def test_a_plate_that_is_pressed_from_zero_on_is_within_the_uncertainty() -> None:
    """Distances from depth 0 were too long by 1.7 standard deviations, in every scan."""
    for pressed_um in (np.arange(15.0, 0, -3), np.arange(27.0, 0, -3)):
        assert np.sqrt(np.mean(np.square(pulls(responses(slow, pressed_um, 0.0), SLOW)), axis=0)).max() < 1.4


def test_depths_are_counted_from_zero_where_the_signals_allow_it() -> None:
    """A curve that is level in contact had it at the first depths at random, off by 5 to 10 standard deviations."""
    found = responses(flat, np.empty(0), 0.0)
    assert {each.contact_um for each in found} == {0.0}
    assert np.abs(pulls(found, (40.0, 120.0, 40.0, 120.0))).max() < 4


def test_depths_that_count_from_a_plate_still_pressed_are_noted_and_uncertain() -> None:
    found = responses(slow, np.arange(40.0, 0, -3), 0.0)
    notes = [note for each in found for note in axial_notes(each) if "do not change" in note]
    assert len(notes) >= 18
    assert all("count the depths from contact" in note for note in notes)
    assert np.median(np.abs(pulls(found, SLOW)[:, 2])) < 2


def test_signals_that_fall_from_the_first_depth_on_are_not_noted_as_level() -> None:
    for each in responses(slow, np.empty(0), 0.0, noise=0.02):
        assert not any("do not change" in note for note in axial_notes(each))
        assert each.contact_um == 0


def test_a_focus_between_two_depths_leaves_the_distances_of_a_slow_curve_uncertain() -> None:
    """At a cusp the signal of contact is too small as well: LS 10 dB was off by 3 %, 5 standard deviations."""
    found = []
    for start in np.linspace(-63, -57, 13):
        depth = np.arange(start, 700, 6.0)
        ls, els = slow(np.abs(depth))
        found.append(axial_response(depth, ls, ls - els))
    assert np.abs(pulls(found, SLOW)).max() < 3
    assert np.std(pulls(found, SLOW)[:, 1]) > 0.3  # nor more uncertain than it is
