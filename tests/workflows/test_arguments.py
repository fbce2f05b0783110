"""Public functions refuse what they cannot take by one of the errors that state the remedy, before anything is done."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import napari_elsplus as elsplus
from napari_elsplus.errors import ElsPlusError, InputError
from napari_elsplus.processing.calibration.draft import Draft
from napari_elsplus.processing.images.cores import CoreFilter
from napari_elsplus.processing.images.modes import Mode
from napari_elsplus.processing.mosaicing.mosaic import Insertion

if TYPE_CHECKING:
    from collections.abc import Callable

NAME = "moving.ome.tif"
RECORDING = elsplus.simulate_recording(frames=2)
FRAMES = np.zeros((2, 524, 1328), np.uint8)
CAL = RECORDING.calibration
TAKING_FRAMES: dict[str, Callable[[Any, Any], object]] = {
    "section": elsplus.section,
    "compare": elsplus.compare,
    "mosaic": elsplus.mosaic,
    "track": elsplus.track,
    "axial": lambda frames, calibration: elsplus.measure_axial_response(frames, calibration, [0, 10]),
}
TAKING_CALIBRATION: dict[str, Callable[[Any], object]] = {
    **{name: lambda cal, job=job: job(FRAMES, cal) for name, job in TAKING_FRAMES.items()},  # type: ignore[misc]
    "recommend": lambda cal: elsplus.recommend(cal, 30),
    "save": lambda cal: elsplus.save_calibration("never-written.json", cal),
    "engine": lambda cal: elsplus.open_engine(calibration=cal).__enter__(),
}


@pytest.mark.parametrize("job", TAKING_FRAMES)
@pytest.mark.parametrize(
    ("given", "words"),
    [
        (NAME, f"'{NAME}' is a name: give `open_recording('{NAME}')`"),
        (Path(NAME), f"give `open_recording('{NAME}')`"),
        (FRAMES[0], "3 dimensions, these 2: give frames[np.newaxis]"),
        (FRAMES[np.newaxis], "3 dimensions, these 4"),
        ([1, 2], "these 1: give a series"),
        (3, "the number 3 was given: give an array (T, rows, cols)"),
        (CAL, "a value of type Calibration was given"),
    ],
)
def test_what_is_no_frames_is_refused_with_what_to_give(job: str, given: Any, words: str) -> None:
    with pytest.raises(InputError) as raised:
        TAKING_FRAMES[job](given, CAL)
    assert words in str(raised.value)


@pytest.mark.parametrize("job", ["calibrate", "finished"])
def test_so_are_names_and_single_frames_elsewhere(job: str) -> None:
    run: Callable[[Any], object] = {
        "calibrate": lambda frames: elsplus.calibrate(bundle=frames),
        "finished": lambda frames: elsplus.mosaic(frames, finished=True),
    }[job]
    for given in (3, FRAMES[0]):
        with pytest.raises(InputError, match="give"):
            run(given)


@pytest.mark.parametrize("job", TAKING_CALIBRATION)
@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("cal.json", "'cal.json' is a name: give `load_calibration('cal.json')`"),
        (Draft(), "type Draft was given: give its attribute `calibration`"),
        (FRAMES, "type ndarray was given: give `load_calibration(path)`"),
    ],
)
def test_what_is_no_calibration_is_refused_with_what_to_give(job: str, given: Any, words: str) -> None:
    with pytest.raises(InputError) as raised:
        TAKING_CALIBRATION[job](given)
    assert words in str(raised.value)


@pytest.mark.parametrize("job", ["section", "compare", "mosaic", "recommend", "save"])
def test_without_a_calibration_the_error_names_one(job: str) -> None:
    with pytest.raises(ElsPlusError, match=r"calibration.*: give"):
        TAKING_CALIBRATION[job](None)


@pytest.mark.parametrize("kind", [Mode, CoreFilter, Insertion])
def test_a_wrong_choice_names_the_choices(kind: type[Mode]) -> None:
    with pytest.raises(InputError) as raised:
        kind("ELS+")
    assert "'ELS+' is no " in str(raised.value)
    assert all(repr(choice.value) in str(raised.value) for choice in kind)


def test_every_function_with_a_choice_refuses_a_wrong_one(tmp_path: Path) -> None:
    RECORDING.save(tmp_path / "moving.ome.tif")
    calls: list[Callable[[], object]] = [
        lambda: elsplus.section(FRAMES, CAL, "ELS+"),
        lambda: elsplus.section(FRAMES, CAL, cores="mean"),
        lambda: elsplus.mosaic(FRAMES, CAL, "ELS+"),
        lambda: elsplus.mosaic(FRAMES, CAL, insertion="mean"),
        lambda: elsplus.track(FRAMES, CAL, "ELS+"),
        lambda: elsplus.batch(tmp_path, tmp_path / "out", mode="ELS+"),
        lambda: elsplus.simulate_axial_scan(state="z"),
        lambda: elsplus.simulate_calibration(state="z"),
    ]
    for call in calls:
        with pytest.raises(InputError, match="choose one of"):
            call()


@pytest.mark.parametrize("given", ["line-bow=3", {"line-bow": 3}])
def test_imperfections_as_text_or_table_are_refused_at_once(given: Any) -> None:
    for simulate in (elsplus.simulate_recording, elsplus.simulate_axial_scan, elsplus.simulate_calibration):
        with pytest.raises(InputError, match=r"Imperfections\.(parse|of)\("):
            simulate(imperfections=given)


@pytest.mark.parametrize("numbers", [{"times_s": [0.0]}, {"frame_numbers": [0, 1, 2]}])
def test_times_and_numbers_must_be_one_for_each_frame(numbers: dict[str, Any]) -> None:
    for job in (elsplus.mosaic, elsplus.track):
        with pytest.raises(InputError, match="2 frames: give one for each frame"):
            job(FRAMES, CAL, **numbers)


def test_what_is_no_path_is_refused() -> None:
    calls: list[Callable[[], object]] = [
        lambda: elsplus.open_recording(FRAMES),  # type: ignore[arg-type]
        lambda: elsplus.load_calibration(CAL),  # type: ignore[arg-type]
        lambda: elsplus.save_calibration(CAL, "cal.json"),  # type: ignore[arg-type]
        lambda: elsplus.batch([NAME], "out"),  # type: ignore[arg-type]
        lambda: elsplus.batch(".", "out", calibration=CAL),  # type: ignore[arg-type]
    ]
    for call in calls:
        with pytest.raises(InputError, match="a path is expected, a value of type"):
            call()


def test_an_unknown_recording_of_a_calibration_is_refused() -> None:
    with pytest.raises(InputError, match=r"'backgroud'.*choose among line, .*background"):
        elsplus.calibrate(backgroud=FRAMES)


def test_lazy_sequences_are_not_read_for_the_tests() -> None:
    class Counted:
        read = 0

        def __len__(self) -> int:
            return 2

        def __getitem__(self, index: int) -> Any:
            self.read += 1
            return FRAMES[index]

    from napari_elsplus.instrument.arguments import require_frames

    frames = Counted()
    require_frames(frames)
    require_frames(list(FRAMES))
    assert frames.read == 0
