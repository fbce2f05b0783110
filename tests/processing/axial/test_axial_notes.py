from __future__ import annotations

import numpy as np
import pytest

from napari_elsplus.processing.axial.axial_notes import axial_notes
from napari_elsplus.processing.axial.axial_response import AxialResponse, axial_response

DEPTH_UM = np.concatenate([np.arange(0.0, 800.0, 4.0), np.arange(800.0, 0.0, -4.0)])


def response(power: np.ndarray | float, depth_um: np.ndarray = DEPTH_UM) -> AxialResponse:
    ls = 100 / (1 + depth_um / 60)
    return axial_response(depth_um, power * ls, power * (ls - 80 / (1 + (depth_um / 30) ** 2)))


def test_a_steady_scan_there_and_back_needs_no_note() -> None:
    assert axial_notes(response(1.0)) == []


def test_one_way_does_not_show_bleaching() -> None:
    (note,) = axial_notes(response(1.0, np.arange(0.0, 800.0, 2.0)))
    assert "record the scan there and back" in note


def test_bleaching_is_named_with_its_share() -> None:
    (note,) = axial_notes(response(np.exp(-0.3 * np.arange(len(DEPTH_UM)) / len(DEPTH_UM))))
    assert note.startswith("warning: the light fell by 2")
    assert note.endswith("% in the course of the scan: corrected")


@pytest.mark.parametrize(
    ("noise", "remedy"), [(0.05, "times as many frames"), (0.3, "the line jitters or the light varies")]
)
def test_the_remedy_is_frames_only_where_they_would_help(noise: float, remedy: str) -> None:
    power = np.exp(np.random.default_rng(7315).normal(0, noise, len(DEPTH_UM)))
    assert remedy in axial_notes(response(power))[-1]


@pytest.mark.parametrize(("step_um", "advised"), [(2.0, False), (8.0, True), (25.0, True), (50.0, True)])
def test_finer_steps_are_advised_where_depths_are_coarse_not_more_frames(step_um: float, advised: bool) -> None:
    depths = np.arange(0.0, 800.0, step_um)
    notes = axial_notes(response(1.0, np.r_[depths, depths[::-1]]))
    assert any("near the 3 dB point: record at steps of at most" in note for note in notes) == advised
    assert not any("times as many frames" in note for note in notes)


@pytest.mark.parametrize(("first_um", "noted"), [(0.0, False), (100.0, True), (-50.0, True)])
def test_contact_that_was_not_seen_is_noted_unless_depths_count_from_it(first_um: float, noted: bool) -> None:
    ls = 100 / (1 + DEPTH_UM / 60)
    found = axial_response(first_um + DEPTH_UM, ls, ls - 80 / (1 + (DEPTH_UM / 30) ** 2))
    assert any("contact was taken to be the first depth" in note for note in axial_notes(found)) == noted


def test_contact_that_was_passed_needs_no_note() -> None:
    there = np.r_[np.arange(-40.0, -1.0, 4.0), np.arange(-1.0, 1.0, 0.5), np.arange(1.0, 800.0, 4.0)]
    depths = np.r_[there, there[::-1]]
    ls = 100 / (1 + np.abs(depths) / 60)
    assert axial_notes(axial_response(depths, ls, ls - 80 / (1 + (depths / 30) ** 2))) == []
