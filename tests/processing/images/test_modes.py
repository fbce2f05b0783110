"""ELSA's frame pairing: confocal view of even frames, residual view of odd ones."""

from __future__ import annotations

from napari_elsplus.processing.images.modes import FRAMES_PER_IMAGE, elsa_frames, elsa_pair
from napari_elsplus.processing.images.sectioning import Mode


def test_every_frame_belongs_to_exactly_one_image() -> None:
    frames = [number for index in range(5) for number in elsa_frames(index)]
    assert frames == list(range(5 * FRAMES_PER_IMAGE))
    assert all(number in elsa_pair(number) for number in frames)


def test_only_elsa_takes_its_views_from_two_frames() -> None:
    assert {mode: mode.source_frames(7) for mode in Mode if mode is not Mode.ELSA} == {
        Mode.LS: (7, 7), Mode.RESIDUAL: (7, 7), Mode.ELS: (7, 7)
    }  # fmt: skip
    assert Mode.ELSA.source_frames(7) == (14, 15)
    assert [mode.frames_per_image for mode in (Mode.LS, Mode.ELSA)] == [1, 2]
