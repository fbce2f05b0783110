"""Recordings survive kills, full disks and their own callers."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
import time

import numpy as np
import pytest
import tifffile

from napari_elsplus.errors import InputError
from napari_elsplus.instrument.calibration import Calibration
from napari_elsplus.io import RecordingWriter, open_recording, read_calibration
from napari_elsplus.io.formats.tiff_pages import PageLayout
from napari_elsplus.io.recorder import RESERVED_BYTES

CALIBRATION = Calibration.parse(
    {
        "frame": {"shape": [30, 47]},
        "optics": {"um_per_px": 1.333, "line_period_s": 7.6e-6, "rows_per_frame": 545.0},
        "made_by": "µ",
    }
).model_copy(update={"background": np.full((30, 47), 3.5, np.float32)})


def frame(k, shape=(30, 47), dtype=np.uint8):
    return np.random.default_rng(k).integers(0, np.iinfo(dtype).max, shape, dtype=dtype)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("shape", [(30, 47), (7, 5), (1, 1)])
def test_everything_that_was_recorded_is_read_back(tmp_path, dtype, shape):
    path = tmp_path / "r.ome.tif"
    numbers = [0, 1, 2, 5, 6]  # two frames were dropped
    with RecordingWriter(path, shape, dtype, calibration=CALIBRATION, settings={"gain_db": 3.0}) as writer:
        for k in numbers:
            writer.append(frame(k, shape, dtype), 10 + k / 240, k)
        assert len(writer) == 5
    with open_recording(path) as recording:
        assert recording.shape == (5, *shape)
        np.testing.assert_array_equal(recording[:], [frame(k, shape, dtype) for k in numbers])
        assert recording.frame_numbers.tolist() == numbers
        np.testing.assert_array_equal(recording.times_s, 10 + np.array(numbers) / 240)
        assert recording.metadata["um_per_px"] == 1.333
        assert recording.metadata["frame_period_s"] == pytest.approx(1 / 240)
        assert recording.metadata["settings"] == {"gain_db": 3.0}
        assert recording.metadata["software"].startswith("napari-elsplus")
        assert recording.calibration.optics.um_per_px == 1.333
        assert recording.calibration.background.mean() == 3.5


def test_the_interval_of_frames_is_known_by_their_numbers_where_most_of_them_were_lost(tmp_path):
    """And where the camera was started again, which counts from 0 anew."""
    numbers = [0, 2, 4, 7, 9, 11, 0, 2, 4]
    with RecordingWriter(tmp_path / "r.ome.tif", (30, 47), np.uint8) as writer:
        for k, number in enumerate(numbers):
            writer.append(frame(k), 0.02 * number + (5.0 if k > 5 else 0.0), number)
    with open_recording(writer.path) as recording:
        assert recording.metadata["frame_period_s"] == pytest.approx(0.02)


@pytest.mark.parametrize("name", ["r.npy", "r.avi", "r.ome.zarr", "r.raw", "r", "tif"])
def test_a_name_that_is_not_that_of_a_tiff_is_refused(tmp_path, name):
    with pytest.raises(InputError, match=rf"{name} has a suffix that cannot be written: let it end in \.ome\.tif, "):
        RecordingWriter(tmp_path / name, (30, 47), np.uint8, calibration=CALIBRATION)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["r.btf", "r.tiff", "r.OME.TIF"])
def test_names_of_tiffs_are_read_as_recordings(tmp_path, name):
    with RecordingWriter(tmp_path / name, (30, 47), np.uint8) as writer:
        writer.append(frame(0), 0.0, 0)
    with open_recording(tmp_path / name) as recording:
        np.testing.assert_array_equal(recording[0], frame(0))


def test_a_recording_without_frames_leaves_nothing(tmp_path):
    RecordingWriter(tmp_path / "r.ome.tif", (30, 47), np.uint8, calibration=CALIBRATION).close()
    assert not list(tmp_path.iterdir())


def test_a_disk_that_is_full_before_the_first_frame_keeps_nothing(tmp_path, monkeypatch):
    """Before: an empty file, which no software opens, and its calibration stayed."""

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("napari_elsplus.io.recorder.write_at", full)
    with (
        pytest.raises(OSError, match="No space left"),
        RecordingWriter(tmp_path / "r.ome.tif", (30, 47), np.uint8, calibration=CALIBRATION) as writer,
    ):
        writer.append(frame(0), 0.0, 0)
    assert list(tmp_path.iterdir()) == []


def test_no_calibration_of_an_earlier_recording_stays_beside_a_new_one(tmp_path):
    path = tmp_path / "r.ome.tif"
    with RecordingWriter(path, (30, 47), np.uint8, calibration=CALIBRATION) as writer:
        writer.append(np.zeros((30, 47), np.uint8), 0.0, 0)
    path.unlink()
    with pytest.raises(InputError, match=r"r\.calibration\.json exists"):
        RecordingWriter(path, (30, 47), np.uint8)
    with RecordingWriter(path, (30, 47), np.uint8, force=True) as writer:
        writer.append(np.zeros((30, 47), np.uint8), 0.0, 0)
    with open_recording(path) as recording:
        assert recording.calibration is None


def test_an_earlier_recording_stays_where_the_calibration_of_a_new_one_cannot_be_written(tmp_path, monkeypatch):
    path = tmp_path / "r.ome.tif"
    with RecordingWriter(path, (30, 47), np.uint8, calibration=CALIBRATION) as writer:
        writer.append(frame(0), 0.0, 0)

    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("napari_elsplus.io.calibrations.np.savez_compressed", full)
    with pytest.raises(OSError, match="No space left"):
        RecordingWriter(path, (30, 47), np.uint8, calibration=CALIBRATION, force=True)
    with open_recording(path) as recording:
        np.testing.assert_array_equal(recording[0], frame(0))
        assert recording.calibration.background.mean() == 3.5


def test_other_software_reads_it_too(tmp_path):
    path = tmp_path / "r.ome.tif"
    with RecordingWriter(path, (30, 47), np.uint8, calibration=CALIBRATION) as writer:
        for k in range(4):
            writer.append(frame(k), k / 240, k)
    with tifffile.TiffFile(path) as file:
        assert file.is_ome
        assert file.is_bigtiff
        assert file.series[0].axes == "TYX"
        np.testing.assert_array_equal(file.asarray(), [frame(k) for k in range(4)])
        starts = [page.dataoffsets[0] for page in file.pages]
        assert len(set(np.diff(starts))) == 1
        assert "napari-elsplus/calibration" in file.ome_metadata


def test_frames_stay_when_the_file_is_closed(tmp_path):
    path = tmp_path / "r.ome.tif"
    with RecordingWriter(path, (30, 47), np.uint8) as writer:
        for k in range(4):
            writer.append(frame(k), k / 240, k)
    with open_recording(path) as recording:
        one, block = recording[3], recording[1:3]
    np.testing.assert_array_equal(one, frame(3))
    np.testing.assert_array_equal(block[1], frame(2))


def test_the_callers_buffer_is_its_own(tmp_path):
    path, buffer = tmp_path / "r.ome.tif", np.zeros((30, 47), np.uint8)
    with RecordingWriter(path, (30, 47), np.uint8) as writer:
        for k in range(5):
            buffer[:] = k
            writer.append(buffer, k / 240, k)
        buffer[:] = 255
        assert sys.getrefcount(buffer) == 2
    with open_recording(path) as recording:
        assert recording[:].max(axis=(1, 2)).tolist() == [0, 1, 2, 3, 4]


def test_calibration_lies_beside_before_the_first_frame(tmp_path):
    writer = RecordingWriter(tmp_path / "r.ome.tif", (30, 47), np.uint8, calibration=CALIBRATION)
    assert read_calibration(tmp_path / "r.calibration.json").background is not None
    writer.close()


def test_wrong_frames_and_existing_files_are_refused(tmp_path):
    path = tmp_path / "r.ome.tif"
    with RecordingWriter(path, (30, 47), np.uint8) as writer:
        writer.append(frame(0), 0, 0)
        with pytest.raises(InputError, match=r"frame 1 is \(30, 46\)"):
            writer.append(frame(0)[:, 1:], 0, 1)
        with pytest.raises(InputError, match="uint16"):
            writer.append(frame(0).astype(np.uint16), 0, 1)
    with pytest.raises(InputError, match="ended"):
        writer.append(frame(0), 0, 0)
    before = path.read_bytes()
    with pytest.raises(InputError, match="exists"):
        RecordingWriter(path, (30, 47), np.uint8)
    assert path.read_bytes() == before
    with pytest.raises(InputError, match="float64"):
        RecordingWriter(tmp_path / "f.ome.tif", (30, 47), np.float64)
    with RecordingWriter(path, (30, 47), np.uint8, force=True) as writer:
        writer.append(frame(7), 0, 0)
    with open_recording(path) as recording:
        np.testing.assert_array_equal(recording[:], [frame(7)])


ENDLESS = """
import itertools, sys
import numpy as np
from napari_elsplus.io import RecordingWriter
writer = RecordingWriter(sys.argv[1], (200, 300), np.uint8)
for k in itertools.count():
    writer.append(np.full((200, 300), k % 251, np.uint8), k / 240, k)
    if k == 20:
        print("going", flush=True)
"""


@pytest.mark.parametrize("patience_s", [0.0, 0.013, 0.05, 0.11])
def test_after_a_kill_all_whole_pages_open(tmp_path, patience_s):
    path = tmp_path / "r.ome.tif"
    with subprocess.Popen([sys.executable, "-c", ENDLESS, str(path)], stdout=subprocess.PIPE) as child:
        assert child.stdout.readline() == b"going\n"
        time.sleep(patience_s)
        child.kill()
    with open_recording(path) as recording:
        count = len(recording)
        assert count >= 20
        assert recording.frame_numbers.tolist() == list(range(count))
        assert recording[:].min(axis=(1, 2)).tolist() == [k % 251 for k in range(count)]
        assert recording[:].max(axis=(1, 2)).tolist() == [k % 251 for k in range(count)]
    with tifffile.TiffFile(path) as file:  # other software reads it too
        assert count - 1 <= len(file.pages) <= count
        assert {page.asarray().shape for page in file.pages} == {(200, 300)}


@pytest.mark.parametrize(("part", "zeros"), [(0.0, 0), (0.3, 0), (0.999, 0), (0.0, 10_000)])
def test_a_page_that_was_cut_and_zeros_after_a_power_cut_are_not_opened(tmp_path, part, zeros):
    path = tmp_path / "r.ome.tif"
    with RecordingWriter(path, (30, 47), np.uint8) as writer:
        for k in range(9):
            writer.append(frame(k), k / 240, k)
    with tifffile.TiffFile(path) as file:
        start, end = file.pages[5].offset, file.pages[6].offset
    path.write_bytes(path.read_bytes()[: int(start + part * (end - start))] + bytes(zeros))
    with open_recording(path) as recording:
        np.testing.assert_array_equal(recording[:], [frame(k) for k in range(5)])


FULL_DISK = """
import json, resource, signal, sys
import numpy as np
from napari_elsplus.errors import InputError
from napari_elsplus.io import RecordingWriter
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, 300_000))
writer, said = RecordingWriter(sys.argv[1], (100, 200), np.uint8), []
for k in range(30):
    try:
        writer.append(np.full((100, 200), k, np.uint8), k / 240, k)
    except OSError as error:
        said.append(str(error))
        break
try:
    writer.append(np.zeros((100, 200), np.uint8), 0, 0)
except InputError as error:
    said.append("ended")
writer.close()
print(json.dumps([said, len(writer), writer.closed]))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="needs a limit on the size of files")
def test_a_full_disk_is_said_once_and_keeps_what_was_written(tmp_path):
    path = tmp_path / "r.ome.tif"
    run = subprocess.run([sys.executable, "-c", FULL_DISK, str(path)], capture_output=True, text=True, check=True)
    said, count, closed = json.loads(run.stdout)
    assert len(said) == 2
    assert "ended after 14 frames" in said[0]
    assert closed
    assert run.stderr == ""
    assert path.stat().st_size == PageLayout((100, 200), np.dtype(np.uint8)).start(14)  # no half page is left
    with open_recording(path) as recording:
        assert len(recording) == count == 14
        assert recording[:].max(axis=(1, 2)).tolist() == list(range(14))
    assert len(tifffile.imread(path, key=slice(None))) == 14


def test_a_disk_that_fails_while_it_is_flushed_is_said_at_the_next_frame(tmp_path, monkeypatch):
    """The flush runs beside; what it meets must not end in a thread that nobody hears."""

    def failing(_):
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr("napari_elsplus.io.recorder.FLUSH_PERIOD_S", 0.01)
    writer = RecordingWriter(tmp_path / "r.ome.tif", (30, 47), np.uint8)
    writer.append(frame(0), 0.0, 0)
    monkeypatch.setattr("os.fsync", failing)
    writer._flusher.join(timeout=100)
    assert not writer._flusher.is_alive()
    with pytest.raises(OSError, match="ended after 1 frames"):
        writer.append(frame(1), 0.1, 1)
    assert writer.closed
    with open_recording(tmp_path / "r.ome.tif") as recording:
        np.testing.assert_array_equal(recording[:], [frame(0)])


@pytest.mark.skipif(os.name == "nt", reason="a file that is open cannot be removed there")
def test_a_recording_that_is_removed_while_it_is_written_ends_with_its_number_of_frames(tmp_path, monkeypatch):
    """Its cut to whole pages failed for want of the file, and the number was lost."""
    monkeypatch.setattr("napari_elsplus.io.recorder.FLUSH_PERIOD_S", 0.01)
    writer = RecordingWriter(tmp_path / "r.ome.tif", (30, 47), np.uint8)
    writer.append(frame(0), 0.0, 0)
    (tmp_path / "r.ome.tif").unlink()
    writer._flusher.join(timeout=10)
    with pytest.raises(FileNotFoundError, match="ended after 1 frames"):
        writer.append(frame(1), 0.1, 1)
    writer.close()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(sys.platform != "linux", reason="there is no such call")
def test_a_disk_that_failed_after_the_last_frame_is_said_at_the_end_and_the_file_is_whole(tmp_path, monkeypatch):
    """Before: a system reports a lost write once; the flush beside had swallowed it, and the end was well."""
    path = tmp_path / "still.ome.tif"
    monkeypatch.setattr("napari_elsplus.io.recorder.FLUSH_PERIOD_S", 0.05)
    fsync, failures = os.fsync, [OSError(errno.EIO, os.strerror(errno.EIO))]

    def failing_once(file: int) -> None:
        fsync(file)
        if failures:
            raise failures.pop()

    writer = RecordingWriter(path, (40, 60), np.uint8)
    for k in range(3):
        writer.append(np.full((40, 60), k, np.uint8), time_s=k / 240, frame_number=k)
    monkeypatch.setattr("os.fsync", failing_once)
    writer._flusher.join(timeout=100)
    with pytest.raises(OSError, match="may not have reached the disk") as raised:
        writer.close()
    assert raised.value.errno == errno.EIO
    with open_recording(path) as recording:
        assert recording.frame_numbers.tolist() == [0, 1, 2]
        assert recording.metadata["frame_period_s"] == pytest.approx(1 / 240)


def test_what_is_flushed_leaves_the_systems_memory(tmp_path, monkeypatch):
    """A file of gigabytes would fill it, and every new page costs time; the newest page still has to be linked."""
    released = []
    monkeypatch.setattr("os.posix_fadvise", lambda _, *what: released.append(what))
    with RecordingWriter(tmp_path / "r.ome.tif", (30, 47), np.uint8) as writer:
        for k in range(4):
            writer.append(frame(k), k / 240, k)
        writer._flush()
        assert released == [(0, PageLayout((30, 47), np.dtype(np.uint8)).start(3), os.POSIX_FADV_DONTNEED)]


@pytest.mark.skipif(sys.platform != "linux", reason="space is reserved on Linux alone")
def test_the_space_that_is_reserved_while_recording_is_given_back(tmp_path):
    path = tmp_path / "a.ome.tif"
    with RecordingWriter(path, (20, 30), np.uint8) as writer:
        writer.append(np.zeros((20, 30), np.uint8), 0.0, 0)
        size, taken = path.stat().st_size, 512 * path.stat().st_blocks
        assert size < 10_000
        assert taken >= RESERVED_BYTES or taken < 100_000  # not every file system can
    assert 512 * path.stat().st_blocks < 100_000
