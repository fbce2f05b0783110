"""A long recording's images, made in spans, are those of a single run, whenever the batch is killed."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from napari_elsplus.errors import InputError
from napari_elsplus.io import open_recording
from napari_elsplus.workflows.batch import spans, stages
from napari_elsplus.workflows.batch.job import FORMATS, RECORDS
from napari_elsplus.workflows.batch.run import batch
from napari_elsplus.workflows.batch.spans import split
from napari_elsplus.workflows.sectioning import SectionedImages, section

if TYPE_CHECKING:
    from collections.abc import Callable


@pytest.fixture
def filled(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, int]]:
    """The spans of two images that are filled, in their order, with the names of their recordings."""
    monkeypatch.setattr(spans, "SPAN_IMAGES", 2)
    seen: list[tuple[str, int]] = []
    fill = stages.fill_span

    def counted(span: range, item: Any, recording: Any) -> Any:
        found = fill(span, item, recording)
        seen.append((item.name, span.start))
        return found

    monkeypatch.setattr(stages, "fill_span", counted)
    return seen


def killed_in(monkeypatch: pytest.MonkeyPatch, owner: Any, name: str, *, after: bool) -> None:
    """Let the next call of a function end as by a kill, before or after what it does."""
    whole: Callable[..., Any] = getattr(owner, name)

    def killed(*arguments: Any, **options: Any) -> None:
        monkeypatch.setattr(owner, name, whole)
        if after:
            whole(*arguments, **options)
        raise KeyboardInterrupt

    monkeypatch.setattr(owner, name, killed)


def contents(path: Path) -> dict[str, bytes]:
    """Contents of a file, or of every file of a folder, without the random identifiers of OME-XML."""
    files = [path] if path.is_file() else sorted(file for file in path.rglob("*") if file.is_file())
    return {str(file.relative_to(path)): re.sub(rb"urn:uuid:[0-9a-f-]{36}", b"", file.read_bytes()) for file in files}


def test_spans_are_equal_and_cover_all_images() -> None:
    for images in (1, 240, 899, 900, 1201, 12345):
        parts = split(images)
        assert [index for part in parts for index in part] == list(range(images))
        assert max(map(len, parts)) - min(map(len, parts)) <= 1
        assert len(parts) == 1 or spans.SPAN_IMAGES / 2 < len(parts[0]) < 2 * spans.SPAN_IMAGES


@pytest.mark.usefixtures("inline")
@pytest.mark.parametrize("file_format", FORMATS)
def test_spans_make_the_file_of_a_single_run(
    recordings: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    filled: list[tuple[str, int]],
    file_format: str,
) -> None:
    spanned, whole = tmp_path / "spanned", tmp_path / "whole"
    rows = batch(recordings, spanned, file_format=file_format).rows
    assert filled == [("a", 0), ("a", 2), ("c", 0), ("c", 2)]
    monkeypatch.setattr(spans, "SPAN_IMAGES", 4)
    assert batch(recordings, whole, file_format=file_format).rows == rows
    assert len(filled) == 4
    name = f"els{FORMATS[file_format]}"
    with open_recording(recordings / "a.tif") as raw:
        assert raw.calibration is not None
        section(raw, raw.calibration).save(tmp_path / name)
    assert contents(spanned / "a" / name) == contents(whole / "a" / name) == contents(tmp_path / name)
    assert contents(spanned / "contact-sheet.png") == contents(whole / "contact-sheet.png")
    assert not [*(spanned / RECORDS).rglob("spans"), *spanned.rglob(".????????.*")]


@pytest.mark.usefixtures("inline")
@pytest.mark.parametrize("file_format", FORMATS)
def test_a_batch_that_is_killed_anywhere_in_a_recording_makes_no_span_twice(
    recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, filled: list[tuple[str, int]], file_format: str
) -> None:
    whole, out, name = tmp_path / "whole", tmp_path / "out", f"els{FORMATS[file_format]}"
    batch(recordings, whole, file_format=file_format)
    filled.clear()
    for owner, function, after in (
        (SectionedImages, "allocate", True),  # the unfinished file was not renamed
        (stages, "fill_span", False),
        (spans.SpannedImages, "remember", True),
        (spans.SpannedImages, "remember", False),  # the second span is filled, but not recorded: it is filled again
        (spans, "put_in_place", False),
        (spans, "put_in_place", True),
    ):
        with monkeypatch.context() as patch:
            killed_in(patch, owner, function, after=after)
            with pytest.raises(KeyboardInterrupt):
                batch(recordings, out, file_format=file_format)
        assert not (out / "table.csv").exists()
    (out / RECORDS / "c" / ".deadbeef.spans" / name).mkdir(parents=True)  # of a worker that was killed at once
    (out / RECORDS / "c" / "spans").mkdir()
    (out / RECORDS / "c" / "spans" / "plan.json").write_bytes(b"")  # before: a plan that a disk lost was an error
    batch(recordings, out, file_format=file_format)
    assert filled == [("a", 0), ("a", 2), ("a", 2), ("c", 0), ("c", 2)]
    for recording in ("a", "c"):
        assert contents(out / recording / name) == contents(whole / recording / name)
    assert not [*(out / RECORDS).rglob("spans"), *out.rglob(".????????.*")]


@pytest.mark.usefixtures("inline")
def test_spans_of_another_recording_are_not_resumed(
    recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, filled: list[tuple[str, int]]
) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    for name in ("a.tif", "a.calibration.json", "a.calibration.npz"):
        (folder / name).write_bytes((recordings / name).read_bytes())
    with monkeypatch.context() as patch:
        killed_in(patch, spans.SpannedImages, "remember", after=True)
        with pytest.raises(KeyboardInterrupt):
            batch(folder, tmp_path / "out")
    (folder / "a.tif").write_bytes((recordings / "c.tif").read_bytes())
    os.utime(folder / "a.tif", (1, 1))
    batch(folder, tmp_path / "out")
    assert filled == [("a", 0), ("a", 0), ("a", 2)]
    with open_recording(folder / "a.tif") as raw, open_recording(tmp_path / "out" / "a" / "els.ome.tif") as made:
        assert raw.calibration is not None
        np.testing.assert_array_equal(made[:], section(raw, raw.calibration)[:])


@pytest.mark.usefixtures("inline", "filled")
def test_a_span_that_fails_fails_its_recording_only(
    recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fill = stages.fill_span

    def failing(span: range, item: Any, recording: Any) -> Any:
        if (item.name, span.start) == ("a", 2):
            raise InputError("frame 3 cannot be read", "copy it again")
        return fill(span, item, recording)

    with monkeypatch.context() as patch:
        patch.setattr(stages, "fill_span", failing)
        result = batch(recordings, tmp_path / "out")
    assert [(row["name"], "frame 3" in row["error"]) for row in result.failed] == [("a", True), ("b", False)]
    assert not (tmp_path / "out" / "a" / "els.ome.tif").exists()
    assert [row["name"] for row in batch(recordings, tmp_path / "out").failed] == ["b"]
