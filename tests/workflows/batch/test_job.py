from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from napari_elsplus.errors import InputError
from napari_elsplus.instrument.calibration import Calibration
from napari_elsplus.io.calibrations import format_calibration
from napari_elsplus.workflows.batch.job import RECORDS, BatchItem, BatchJob, find_recordings, open_output


def touched(*paths: Path) -> list[Path]:
    for path in paths:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"II*\0")
    return list(paths)


def job(output: Path, **changes: object) -> BatchJob:
    return replace(BatchJob(str(output), "els", mosaic=True, calibration=None), **changes)  # type: ignore[arg-type]


def of_scale(um_per_px: float) -> str:
    return format_calibration(Calibration.parse({"optics": {"um_per_px": um_per_px}}))


def test_a_folder_gives_its_recordings_and_nothing_else(tmp_path: Path) -> None:
    touched(tmp_path / "b.ome.tif", tmp_path / "a.tif", tmp_path / "sub" / "c.tif", tmp_path / ".hidden.tif")
    (tmp_path / "a.calibration.json").write_text("{}")
    (tmp_path / "notes.txt").write_text("")
    assert list(find_recordings(tmp_path)) == ["a", "b"]


def test_a_list_is_relative_to_itself_and_names_alike_get_their_folders(tmp_path: Path) -> None:
    files = touched(*(tmp_path / name for name in ("monday/scan.tif", "tuesday/scan.tif", "other.tif")))
    names = tmp_path / "list.txt"
    names.write_text(f"# a comment\nmonday/scan.tif\n\n{files[1]}\nother.tif\n", encoding="utf-8")
    assert find_recordings(names) == dict(zip(("monday-scan", "tuesday-scan", "other"), files, strict=True))


def test_a_folder_with_recordings_in_subfolders_alone_names_them_in_the_error(tmp_path: Path) -> None:
    touched(tmp_path / "day" / "monday" / "scan.ome.tif")
    with pytest.raises(
        InputError, match="day names no recordings, and subfolders are not searched: give a list"
    ) as raised:
        find_recordings(tmp_path / "day")
    assert "monday" in str(raised.value)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="empty names no recordings: give a folder"):
        find_recordings(tmp_path / "empty")


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        ("", "names no recordings"),
        ("a/scan.tif\na/scan.tif\n", "two recordings are called a-scan"),
        ('{\n "made_by": 1\n}', "no file that .*list.txt lists is there, {.* is the first: give a text file of one"),
    ],
)
def test_lists_that_cannot_be_used_are_refused(tmp_path: Path, content: str, problem: str) -> None:
    touched(tmp_path / "a" / "scan.tif")
    (tmp_path / "list.txt").write_text(content)
    with pytest.raises(InputError, match=problem):
        find_recordings(tmp_path / "list.txt")


def test_sources_that_are_neither_are_refused(tmp_path: Path) -> None:
    for absent in ("absent", "absent.tif"):
        with pytest.raises(InputError, match="no folder or list"):
            find_recordings(tmp_path / absent)
    (scan,) = touched(tmp_path / "scan.tif")
    with pytest.raises(InputError, match="is one recording"):
        find_recordings(scan)
    np.arange(300, dtype=np.uint8).tofile(tmp_path / "binary")
    with pytest.raises(InputError, match="no text"):
        find_recordings(tmp_path / "binary")


def test_a_stage_is_recalled_only_for_the_same_file(tmp_path: Path) -> None:
    (scan,) = touched(tmp_path / "scan.tif")
    item = BatchItem("scan", str(scan), job(tmp_path / "out"))
    open_output(item.job)
    item.records.mkdir()
    (images,) = touched(*item.files("section"))
    assert item.recall("section") is None
    item.remember("section", {"images": 3}, item.fingerprint())
    assert item.recall("section") == {"images": 3}
    assert item.recall("mosaic") is None
    images.unlink()
    assert item.recall("section") is None
    touched(images)
    before = item.fingerprint()
    scan.write_bytes(b"another recording")
    assert item.recall("section") is None
    with pytest.raises(InputError, match="changed meanwhile"):
        item.remember("section", {"images": 3}, before)


def test_a_stage_is_recalled_only_for_the_same_frames_of_a_folder(tmp_path: Path) -> None:
    folder = tmp_path / "frames"
    folder.mkdir()
    frames = touched(*(folder / f"{k}.tif" for k in range(3)))
    item = BatchItem("frames", str(folder), job(tmp_path / "out"))
    open_output(item.job)
    item.records.mkdir()
    touched(*item.files("section"))
    item.remember("section", {}, item.fingerprint())
    assert item.recall("section") == {}
    with frames[1].open("r+b") as frame:  # in place: the folder's own time stays
        frame.write(b"another frame")
    assert item.recall("section") is None


def test_a_stage_is_recalled_only_for_the_same_calibration(tmp_path: Path) -> None:
    (scan,) = touched(tmp_path / "scan.tif")
    item = BatchItem("scan", str(scan), job(tmp_path / "out"))
    open_output(item.job)
    item.records.mkdir()
    touched(*item.files("section"))
    beside, folders = tmp_path / "scan.calibration.json", tmp_path / "calibration.json"
    changes = (
        lambda: folders.write_text(of_scale(1.0)),
        lambda: beside.write_text(of_scale(2.0)),
        lambda: beside.write_text(of_scale(3.0)),
        lambda: np.savez(beside.with_suffix(".npz"), flat=np.ones((3, 3))),
        lambda: np.savez(beside.with_suffix(".npz"), flat=np.full((3, 3), 2.0)),
    )
    for change in changes:
        item.remember("section", {}, item.fingerprint())
        assert item.recall("section") == {}
        change()
        assert item.recall("section") is None


def test_an_output_folder_is_resumed_by_the_same_job_only(tmp_path: Path) -> None:
    calibration = tmp_path / "cal.json"
    calibration.write_text("{}")
    first = job(tmp_path / "out", calibration=str(calibration))
    open_output(first)
    open_output(first)
    for other in (replace(first, mode="ls"), replace(first, mosaic=False), replace(first, calibration=None)):
        with pytest.raises(InputError, match="another job"):
            open_output(other)
    np.savez(calibration.with_suffix(".npz"), flat=np.ones((3, 3)))
    with pytest.raises(InputError, match="another job"):
        open_output(first)
    calibration.with_suffix(".npz").unlink()
    calibration.write_text('{"measured": "anew"}')
    with pytest.raises(InputError, match="another job"):
        open_output(first)
    with pytest.raises(InputError, match="other files"):
        open_output(job(tmp_path))


def test_a_damaged_record_of_a_job_is_said_to_be(tmp_path: Path) -> None:
    made = job(tmp_path / "out")
    open_output(made)
    Path(made.output, RECORDS, "job.json").write_bytes(b"")
    with pytest.raises(InputError, match="is no JSON file"):
        open_output(made)
