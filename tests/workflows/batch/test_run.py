"""A batch gives what single runs give, survives a broken recording, and does nothing twice."""

from __future__ import annotations

import csv
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.request import urlopen

import cv2
import numpy as np
import pytest
import tifffile
from click.testing import CliRunner

from napari_elsplus.cli import elsplus
from napari_elsplus.errors import InputError
from napari_elsplus.io import open_recording, read_calibration, read_track, write_calibration
from napari_elsplus.io.atomic import MAX_NAME_BYTES
from napari_elsplus.workflows.batch import cluster, stages, tasks
from napari_elsplus.workflows.batch.cluster import WORKER_ENVIRONMENT, batch_client
from napari_elsplus.workflows.batch.job import FORMATS, BatchItem, BatchJob, open_output
from napari_elsplus.workflows.batch.run import batch
from napari_elsplus.workflows.mosaicing import mosaic
from napari_elsplus.workflows.sectioning import section

if TYPE_CHECKING:
    from collections.abc import Callable


def test_a_batch_on_a_worker_gives_what_single_runs_give(recordings: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = ["batch", str(recordings), "--mosaic", "-o", str(out), "--workers", "1"]
    done = CliRunner().invoke(elsplus, words)
    assert done.exit_code == 1
    assert "2 of 3 recordings done" in done.output
    assert "failed: b: " in done.output
    assert "dashboard: http://127.0.0.1:" in done.output
    rows = {row["name"]: row for row in csv.DictReader((out / "table.csv").read_text(encoding="utf-8").splitlines())}
    assert set(rows) == {"a", "b", "c"}
    assert rows["b"]["error"]
    assert (out / "contact-sheet.png").stat().st_size > 10_000
    with open_recording(recordings / "a.tif") as raw:
        calibration = raw.calibration
        assert calibration is not None
        single = mosaic(raw, calibration)
        images = section(raw, calibration)[:]
    # a kernel that this process has compiled rounds otherwise than the same kernel from the cache: 1e-8 px, 1e-4 levels
    np.testing.assert_allclose(tifffile.imread(out / "a" / "els.ome.tif"), images, rtol=0, atol=1e-3)
    np.testing.assert_allclose(tifffile.imread(out / "a" / "mosaic.ome.tif", key=0), single.image, rtol=0, atol=1e-3)
    track = read_track(out / "a" / "track.csv")
    assert [point.state for point in track] == [point.state for point in single.track]
    np.testing.assert_allclose([p.row_px for p in track], [p.row_px for p in single.track], rtol=0, atol=1e-6)
    assert rows["a"]["images"] == "4"
    assert rows["a"]["tracked"] == str(sum(point.state == "tracked" for point in single.track))


@pytest.mark.usefixtures("inline")
def test_a_batch_is_resumed_without_doing_anything_twice(
    recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    executed: list[str] = []
    killed_at = ["c mosaic"]

    def counted(stage: str, made: Callable[..., Any]) -> Callable[..., Any]:
        def execute(item: Any, recording: Any) -> Any:
            if f"{item.name} {stage}" in killed_at:
                killed_at.clear()
                raise KeyboardInterrupt
            executed.append(f"{item.name} {stage}")
            return made(item, recording)

        return execute

    whole = dict(stages.STAGES)
    monkeypatch.setattr(stages, "STAGES", {name: counted(name, stage) for name, stage in whole.items()})
    out = tmp_path / "out"
    with pytest.raises(KeyboardInterrupt):
        batch(recordings, out, mosaic=True)
    assert executed == ["a mosaic", "a section"]
    left = out / "c" / ".deadbeef.mosaic.ome.tif"
    left.write_bytes(b"what a killed worker left")
    result = batch(recordings, out, mosaic=True)
    assert executed == ["a mosaic", "a section", "c mosaic", "c section"]
    assert [row["name"] for row in result.failed] == ["b"]
    assert not left.exists()


@pytest.mark.usefixtures("inline")
def test_a_recording_may_have_the_longest_name_of_a_file(recordings: Path, tmp_path: Path) -> None:
    longest = "n" * (MAX_NAME_BYTES - len(".tif"))
    shutil.copy(recordings / "a.tif", tmp_path / f"{longest}.tif")
    listed = tmp_path / "list.txt"
    listed.write_text(f"{longest}.tif", encoding="utf-8")
    with open_recording(recordings / "a.tif") as raw:
        calibration = raw.calibration
    assert calibration is not None
    write_calibration(tmp_path / "rig.json", calibration)
    result = batch(listed, tmp_path / "out", calibration=tmp_path / "rig.json", mosaic=True)
    assert not result.failed
    assert (tmp_path / "out" / longest / "mosaic.ome.tif").exists()


@pytest.mark.parametrize(("stage", "own"), [("section", "els.ome.tif"), ("mosaic", "track.csv")])
def test_a_stage_leaves_what_another_worker_is_writing(
    recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stage: str, own: str
) -> None:
    monkeypatch.setattr(stages, "STAGES", {stage: lambda *_: {}})
    job = BatchJob(str(tmp_path / "out"), "els", mosaic=True, calibration=None)
    item = BatchItem("a", str(recordings / "a.tif"), job)
    open_output(job)
    out = tmp_path / "out"
    for folder in (item.folder, item.records):
        folder.mkdir()
    for other in ("section", "mosaic"):
        item.record(other).with_name(f".deadbeef.{item.record(other).name}").touch()
    writing = {name: out / "a" / f".deadbeef.{name}" for name in ("els.ome.tif", "mosaic.ome.tif", "track.csv")}
    for file in writing.values():
        file.touch()
    tasks.run_stage(stage, item)
    assert not writing[own].exists()
    kept = {"els.ome.tif"} if stage == "mosaic" else {"mosaic.ome.tif", "track.csv"}
    assert {name for name, file in writing.items() if file.exists()} == kept
    (record,) = item.records.glob(".deadbeef.*")
    assert stage not in record.name


@pytest.mark.usefixtures("inline")
@pytest.mark.parametrize("mosaic", [False, True])
def test_a_batch_as_ome_zarr_is_resumed_and_has_the_pixels_of_ome_tiff(
    recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mosaic: bool
) -> None:
    outputs = {name: tmp_path / name for name in FORMATS}
    rows = {name: batch(recordings, out, mosaic=mosaic, file_format=name).rows for name, out in outputs.items()}
    assert rows["ome-zarr"] == rows["ome-tiff"]
    for kind in ("els", "mosaic") if mosaic else ("els",):
        files = [out / "a" / f"{kind}{FORMATS[name]}" for name, out in outputs.items()]
        with open_recording(files[0]) as one, open_recording(files[1]) as other:
            np.testing.assert_array_equal(one[:], other[:])
            assert other.metadata["um_per_px"] == pytest.approx(one.metadata["um_per_px"])
            assert other.calibration == one.calibration
    sheets = [(out / "contact-sheet.png").read_bytes() for out in outputs.values()]
    assert sheets[0] == sheets[1]
    left = outputs["ome-zarr"] / "b" / ".deadbeef.els.ome.zarr"
    (left / "0").mkdir(parents=True)  # of the recording that fails, which is tried again
    monkeypatch.setattr(stages, "STAGES", {})
    again = batch(recordings, outputs["ome-zarr"], mosaic=mosaic, file_format="ome-zarr")
    assert [row["name"] for row in again.failed] == ["b"]
    assert not left.exists()
    with pytest.raises(InputError, match=r"another job than els images.* as ome-tiff"):
        batch(recordings, outputs["ome-zarr"], mosaic=mosaic)


@pytest.mark.usefixtures("inline")
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only there names need not be text")
def test_names_of_files_that_are_no_text_are_in_table_and_sheet(recordings: Path, tmp_path: Path) -> None:
    folder, name = tmp_path / "season", os.fsdecode(b"\xb5m")
    folder.mkdir()
    (folder / f"{name}.tif").write_bytes((recordings / "a.tif").read_bytes())
    done = batch(folder, tmp_path / "out", calibration=recordings / "a.calibration.json")
    assert done.failed == []
    assert b"\xb5m.tif" in (tmp_path / "out" / "table.csv").read_bytes()
    assert (tmp_path / "out" / "contact-sheet.png").exists()


def test_an_unknown_format_is_refused_before_any_work(recordings: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no format 'png': choose one of ome-tiff, ome-zarr"):
        batch(recordings, tmp_path / "out", file_format="png")
    assert not (tmp_path / "out").exists()


def test_a_stage_computes_on_one_thread(recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = cv2.getNumThreads()
    threads: list[int] = []
    monkeypatch.setattr(stages, "STAGES", {"section": lambda *_: {"threads": threads.append(cv2.getNumThreads())}})
    job = BatchJob(str(tmp_path / "out"), "els", mosaic=False, calibration=None)
    open_output(job)
    tasks.run_stage("section", BatchItem("a", str(recordings / "a.tif"), job))
    assert threads == [1]
    assert cv2.getNumThreads() == before


def test_a_stage_starts_no_thread(recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("napari_elsplus.workflows.two_threads.Thread", None)
    job = BatchJob(str(tmp_path / "out"), "els", mosaic=True, calibration=None)
    open_output(job)
    for stage in job.stages:
        tasks.run_stage(stage, BatchItem("a", str(recordings / "a.tif"), job))


def test_local_workers_have_one_thread_keep_their_memory_and_have_a_dashboard() -> None:
    before = {name: os.environ.get(name) for name in WORKER_ENVIRONMENT}
    with batch_client(None, 1) as client:
        (environment,) = client.run(lambda: dict(os.environ)).values()
        assert list(client.run(lambda: signal.getsignal(signal.SIGINT) == signal.SIG_IGN).values()) == [True]
        with urlopen(client.dashboard_link) as page:
            assert b"bokeh" in page.read()
    assert {name: os.environ.get(name) for name in WORKER_ENVIRONMENT} == before
    assert environment["OMP_NUM_THREADS"] == "1"
    assert "MALLOC_TRIM_THRESHOLD_" not in environment


INTERRUPTED_WHILE_IT_STARTS = """
import os, signal, time, distributed
from napari_elsplus.workflows.batch.cluster import batch_client

start = distributed.LocalCluster.__init__

def interrupted(*arguments, **settings):
    time.sleep(0.5)  # the process that workers are forked from imports for a second or more
    os.killpg(0, signal.SIGINT)  # as a terminal does
    start(*arguments, **settings)

distributed.LocalCluster.__init__ = interrupted
try:
    with batch_client(None, 1):
        print("started")
except KeyboardInterrupt:
    print("interrupted")
"""


@pytest.mark.skipif(not hasattr(os, "killpg"), reason="Windows has no process groups of this kind")
def test_a_batch_that_is_interrupted_while_its_workers_start_ends_without_a_traceback() -> None:
    program = [sys.executable, "-c", INTERRUPTED_WHILE_IT_STARTS]
    ended = subprocess.run(program, capture_output=True, text=True, check=True, start_new_session=True)
    assert (ended.stdout.split(), ended.stderr) == (["interrupted"], "")


def test_the_process_that_submits_tasks_imports_no_kernels() -> None:
    program = (
        "import sys, napari_elsplus.workflows.batch.run; "
        "print([name for name in ('numba', 'cv2', 'matplotlib') if name in sys.modules])"
    )
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert ended.stdout.strip() == "[]"


@pytest.mark.usefixtures("inline")
def test_frames_of_another_bit_depth_than_the_background_are_noted(recordings: Path, tmp_path: Path) -> None:
    frames, known = tifffile.imread(recordings / "a.tif"), read_calibration(recordings / "a.calibration.json")
    background = np.full(frames.shape[1:], np.median(frames[:, :40]), np.float32)
    (tmp_path / "season").mkdir()
    tifffile.imwrite(tmp_path / "season" / "a.tif", frames.astype(np.uint16) * 16, photometric="minisblack")
    write_calibration(tmp_path / "season" / "a.calibration.json", known.model_copy(update={"background": background}))
    result = batch(tmp_path / "season", tmp_path / "out")
    assert not result.failed
    assert result.rows[0]["warnings"].startswith("beside the views the frames have grey level")
    assert result.notes == (f"a: {result.rows[0]['warnings']}",)


@pytest.mark.usefixtures("inline")
def test_different_calibrations_are_noted_and_a_missing_one_fails_its_recording(
    recordings: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    for name in ("a.tif", "a.calibration.json", "a.calibration.npz", "c.tif"):
        (folder / name).write_bytes((recordings / name).read_bytes())
    with open_recording(recordings / "a.tif") as raw:
        other = raw.calibration
    assert other is not None
    result = batch(folder, tmp_path / "out")
    assert "no calibration lies beside" in result.failed[0]["error"]
    assert not (tmp_path / "out" / "c").exists()
    assert result.notes == ()
    write_calibration(folder / "c.calibration.json", other.model_copy(update={"created": "2026-01-01T00:00:00Z"}))
    result = batch(folder, tmp_path / "out")
    assert result.failed == []
    assert "2 different calibrations" in result.notes[0]


@pytest.mark.usefixtures("inline")
def test_a_batch_after_another_calibration_makes_its_images_anew(recordings: Path, tmp_path: Path) -> None:
    folder, out = tmp_path / "in", tmp_path / "out"
    folder.mkdir()
    for name in ("a.tif", "a.calibration.json", "a.calibration.npz"):
        (folder / name).write_bytes((recordings / name).read_bytes())
    (old,) = batch(folder, out, mosaic=True).rows
    with open_recording(folder / "a.tif") as raw:
        before = raw.calibration
        assert before is not None
        background = np.full(raw.shape[1:], 3, np.float32)
        write_calibration(
            folder / "a.calibration.json", before.model_copy(update={"background": background}), force=True
        )
        (new,) = batch(folder, out, mosaic=True).rows
        assert raw.calibration is not None
        expected = section(raw, raw.calibration)[:]
        assert not np.allclose(expected, section(raw, before)[:], atol=0.1, equal_nan=True)
    np.testing.assert_allclose(tifffile.imread(out / "a" / "els.ome.tif"), expected, rtol=0, atol=1e-3)
    assert old["calibration"] != new["calibration"]
    (out / "a" / "track.csv").unlink()
    batch(folder, out, mosaic=True)
    assert len(read_track(out / "a" / "track.csv")) == 4


def test_a_scheduler_that_is_not_there_is_one_line(
    recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster, "SCHEDULER_TIMEOUT_S", 0.2)
    with pytest.raises(InputError, match=r"no scheduler answers at tcp://127\.0\.0\.1:9"):
        batch(recordings, tmp_path / "out", scheduler="tcp://127.0.0.1:9")
    with pytest.raises(InputError, match="no scheduler answers at nonsense"):
        batch(recordings, tmp_path / "out", scheduler="nonsense:x")
    with pytest.raises(InputError, match=r"the scheduler tcp://127\.0\.0\.1:9 has workers of its own"):
        batch(recordings, tmp_path / "out", scheduler="tcp://127.0.0.1:9", workers=2)
    assert not (tmp_path / "out").exists()
