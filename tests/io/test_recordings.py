"""Every format opens as the same lazy sequence of frames."""

from __future__ import annotations

import gc
import os
import warnings
from concurrent.futures import ThreadPoolExecutor
from fractions import Fraction

import cv2
import numpy as np
import psutil
import pytest
import tifffile
import zarr

from napari_elsplus.errors import ElsPlusError, InputError
from napari_elsplus.instrument.calibration import Calibration
from napari_elsplus.io import Recording, RecordingWriter, open_recording, stored_frames
from videos import write_avi

SHAPE = (7, 40, 64)


@pytest.fixture
def frames():
    return np.random.default_rng(1).integers(0, 255, SHAPE, dtype=np.uint8)


def ours(path, frames):
    with RecordingWriter(path, frames.shape[1:], frames.dtype) as writer:
        for k, frame in enumerate(frames):
            writer.append(frame, k / 240, k)


def zlib_tiff(path, frames):
    tifffile.imwrite(path, frames, compression="zlib")


def ome_tiff(path, frames):
    tifffile.imwrite(path, frames, ome=True, metadata={"axes": "TYX"})


def imagej_tiff(path, frames):
    tifffile.imwrite(path, frames, imagej=True, metadata={"axes": "TYX"})


def plain_pages(path, frames):
    with tifffile.TiffWriter(path) as writer:
        for frame in frames:
            writer.write(frame, contiguous=False, metadata=None)


def big_endian(path, frames):
    tifffile.imwrite(path, frames, byteorder=">")


def tiled(path, frames):
    tifffile.imwrite(path, frames, tile=(16, 16), compression="lzw")


def numpy_file(path, frames):
    with path.open("wb") as file:
        np.save(file, frames)


def fortran_file(path, frames):
    numpy_file(path, np.asfortranarray(frames))


def zarr_2(path, frames, zarr_format=2):
    group = zarr.open_group(path, mode="w", zarr_format=zarr_format)
    array = group.create_array("0", shape=frames.shape, dtype=frames.dtype, chunks=(2, 40, 64))
    array[:] = frames
    axes = [{"name": "t", "unit": "millisecond"}, {"name": "y"}, {"name": "x", "unit": "micrometer"}]
    scale = [{"type": "scale", "scale": [5.0, 0.9, 0.9]}]
    image = {"axes": axes, "datasets": [{"path": "0", "coordinateTransformations": scale}]}
    if zarr_format == 2:
        group.attrs["multiscales"] = [image]
    else:
        group.attrs["ome"] = {"version": "0.5", "multiscales": [image]}


def zarr_3(path, frames):
    zarr_2(path, frames, zarr_format=3)


def zarr_array(path, frames):
    zarr.save_array(path, frames)


def folder(path, frames):
    path.mkdir()
    for k, frame in enumerate(frames):
        tifffile.imwrite(path / f"frame{k + 5}.tif", frame)  # 5 to 11: natural order differs from alphabetical


FORMATS = {
    "r.ome.tif": ours,
    "zlib.tif": zlib_tiff,
    "ome.ome.tif": ome_tiff,
    "imagej.tif": imagej_tiff,
    "pages.tiff": plain_pages,
    "motorola.tif": big_endian,
    "tiled.tif": tiled,
    "stack.npy": numpy_file,
    "fortran.npy": fortran_file,
    "v2.zarr": zarr_2,
    "v3.zarr": zarr_3,
    "array.zarr": zarr_array,
    "folder": folder,
    "video.avi": write_avi,
}


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_gives_the_frames_that_were_written(tmp_path, frames, name):
    FORMATS[name](tmp_path / name, frames)
    with open_recording(tmp_path / name) as recording:
        assert isinstance(recording, Recording)
        assert (recording.shape, recording.dtype, len(recording)) == (SHAPE, np.uint8, 7)
        np.testing.assert_array_equal(recording[3], frames[3])
        np.testing.assert_array_equal(recording[-1], frames[-1])
        np.testing.assert_array_equal(recording[1:6:2], frames[1:6:2])
        np.testing.assert_array_equal(recording[::-1], frames[::-1])
        np.testing.assert_array_equal(np.asarray(recording), frames)
        assert recording[5:5].shape == (0, 40, 64)
        assert recording.frame_numbers.tolist() == list(range(7))
        with pytest.raises(IndexError):
            recording[7]


@pytest.mark.parametrize("name", [name for name in FORMATS if name != "video.avi"])
def test_16_bit_frames_keep_their_depth(tmp_path, frames, name):
    deep = frames.astype(np.uint16) * 257
    FORMATS[name](tmp_path / name, deep)
    with open_recording(tmp_path / name) as recording:
        assert recording.dtype == np.uint16
        assert recording.dtype.isnative
        np.testing.assert_array_equal(recording[:], deep)


@pytest.mark.parametrize("name", [name for name in FORMATS if name not in {"imagej.tif", "video.avi"}])
def test_a_single_image_is_a_recording_of_one_frame(tmp_path, frames, name):
    FORMATS[name](tmp_path / name, frames[:1])
    with open_recording(tmp_path / name) as recording:
        assert recording.shape == (1, 40, 64)
        np.testing.assert_array_equal(recording[0], frames[0])


def test_a_plain_two_dimensional_image_is_one_frame(tmp_path, frames):
    np.save(tmp_path / "one.npy", frames[0])
    tifffile.imwrite(tmp_path / "one.tif", frames[0])
    for name in ("one.npy", "one.tif"):
        with open_recording(tmp_path / name) as recording:
            np.testing.assert_array_equal(recording[0], frames[0])


@pytest.mark.parametrize("name", ["zlib.tif", "r.ome.tif", "v3.zarr", "video.avi"])
def test_threads_may_read_at_once(tmp_path, frames, name):
    FORMATS[name](tmp_path / name, frames)
    with open_recording(tmp_path / name) as recording, ThreadPoolExecutor(4) as pool:
        order = [k % 7 for k in range(0, 60, 3)]
        for k, frame in zip(order, pool.map(recording.__getitem__, order), strict=True):
            np.testing.assert_array_equal(frame, frames[k])


def test_threads_may_read_a_stack_in_several_files_at_once(tmp_path):
    """As Micro-Manager splits long ones: each page is in a file of its own, which is opened when it is needed."""
    files, pages = 3, 20
    for file in range(files):
        with tifffile.TiffWriter(tmp_path / f"part_{file}.ome.tif") as writer:
            for page in range(pages):
                pixels = np.full((120, 200), file * pages + page, np.uint16)
                words = _words_of_parts(files, pages, file) if page == 0 else None
                writer.write(pixels, description=words, metadata=None, contiguous=False)
    order = np.random.default_rng(2).integers(0, files * pages, 600)
    with open_recording(tmp_path / "part_0.ome.tif") as recording, ThreadPoolExecutor(4) as pool:
        assert len(recording) == files * pages
        for k, frame in zip(order, pool.map(recording.__getitem__, order), strict=True):
            assert (frame == k).all()


def _words_of_parts(files, pages, me):
    data = "".join(
        f'<TiffData IFD="{k % pages}" PlaneCount="1" FirstT="{k}" FirstC="0" FirstZ="0">'
        f'<UUID FileName="part_{k // pages}.ome.tif">urn:uuid:{k // pages:036}</UUID></TiffData>'
        for k in range(files * pages)
    )
    return (
        f'<?xml version="1.0" encoding="UTF-8"?><OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06" '
        f'UUID="urn:uuid:{me:036}"><Image ID="Image:0"><Pixels ID="Pixels:0" DimensionOrder="XYCZT" Type="uint16" '
        f'SizeX="200" SizeY="120" SizeC="1" SizeZ="1" SizeT="{files * pages}">'
        f'<Channel ID="Channel:0:0" SamplesPerPixel="1"/>{data}</Pixels></Image></OME>'
    )


@pytest.mark.skipif(not hasattr(os, "preadv"), reason="the file is read by its object")
@pytest.mark.parametrize("name", ["r.ome.tif", "ome.ome.tif", "stack.npy"])
def test_a_frame_that_is_read_while_its_recording_is_closed_is_its_own(tmp_path, frames, monkeypatch, name):
    """The next file that is opened gets the number of the one that was closed, as the system counts them."""
    FORMATS[name](tmp_path / name, frames)
    (tmp_path / "other").write_bytes(bytes(1 << 20))
    recording, others, read = open_recording(tmp_path / name), [], os.preadv

    def closed_meanwhile(*arguments):
        recording.close()
        others.append((tmp_path / "other").open("rb"))
        return read(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr(os, "preadv", closed_meanwhile)
        np.testing.assert_array_equal(recording[3], frames[3])
    assert others
    others.pop().close()


@pytest.mark.parametrize("rate_hz", ["240", "30000/1001", "127.3", "1000"])
@pytest.mark.parametrize("codec", ["rawvideo", "ffv1"])
def test_frames_of_a_video_are_found_in_any_order(tmp_path, rate_hz, codec):
    count = 233
    frames = np.zeros((count, 16, 24), np.uint8)
    frames[:] = np.arange(count)[:, None, None]
    write_avi(tmp_path / "a.avi", frames, "-c:v", codec, "-pix_fmt", "gray", rate_hz=rate_hz)
    with open_recording(tmp_path / "a.avi") as recording:
        order = [*range(count - 1, 0, -19), 0, 40, 45, 200, *np.random.default_rng(1).integers(0, count, 10)]
        assert [int(recording[k][0, 0]) for k in order] == order
        assert recording.metadata["frame_period_s"] == pytest.approx(1 / Fraction(rate_hz), rel=1e-6)


def test_grey_frames_that_opencv_encoded_as_motion_jpeg_open(tmp_path):
    """Its rounding tints grey by two levels, for which such videos were refused as in colour."""
    frames = np.full((3, 48, 64), 90, np.uint8)
    frames[:, 12:30, 20:40] = 180
    writer = cv2.VideoWriter(str(tmp_path / "a.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 50, (64, 48))
    for frame in frames:
        writer.write(cv2.cvtColor(frame, cv2.COLOR_GRAY2BGR))
    writer.release()
    with open_recording(tmp_path / "a.avi") as recording:
        assert recording.shape == frames.shape
        assert np.abs(recording[1].astype(int) - frames[1])[16:26, 24:36].max() <= 2


def test_grey_levels_that_no_camera_delivers_are_refused(tmp_path):
    """Their squares were infinite: warnings of the libraries on the terminal, and an image of nonsense."""
    np.save(tmp_path / "a.npy", np.full((2, 40, 60), 1e30, np.float32))
    with (
        open_recording(tmp_path / "a.npy") as recording,
        pytest.raises(InputError, match=r"frame 0 holds grey level 1e\+30"),
    ):
        recording[0]


def test_frames_that_a_video_dropped_are_gaps_of_its_numbers(tmp_path):
    """The decoder showed the frame before in their place, and none of the last ones."""
    frames = np.zeros((30, 16, 24), np.uint8)
    frames[:] = 8 * np.arange(30)[:, None, None]
    dropped = ("-vf", "select=not(between(n\\,10\\,14))", "-fps_mode", "passthrough", "-c:v", "rawvideo")
    write_avi(tmp_path / "a.avi", frames, *dropped, "-pix_fmt", "gray")
    kept = [*range(10), *range(15, 30)]
    with open_recording(tmp_path / "a.avi") as recording:
        assert [int(frame[0, 0]) // 8 for frame in recording] == kept
        assert [int(recording[k][0, 0]) // 8 for k in (24, 12, 3, 10)] == [kept[k] for k in (24, 12, 3, 10)]
        assert recording.frame_numbers.tolist() == kept
        np.testing.assert_allclose(recording.times_s, 0.02 * np.array(kept))
        calibration = Calibration.parse({"optics": {"line_period_s": 1e-5, "rows_per_frame": 400.0}})
        np.testing.assert_allclose(recording.times_by(calibration), 4e-3 * np.array(kept))
        assert recording.camera_times_by(None) is None


def test_scale_and_interval_are_read(tmp_path, frames):
    words = {"axes": "TYX", "PhysicalSizeX": 900, "PhysicalSizeXUnit": "nm"}
    words |= {"TimeIncrement": 5, "TimeIncrementUnit": "ms"}
    tifffile.imwrite(tmp_path / "a.ome.tif", frames, metadata=words)
    tifffile.imwrite(
        tmp_path / "b.tif", frames, imagej=True, resolution=(1 / 0.9, 1 / 0.9),
        metadata={"axes": "TYX", "unit": "um", "finterval": 0.005},
    )  # fmt: skip
    zarr_3(tmp_path / "c.zarr", frames)
    for name in ("a.ome.tif", "b.tif", "c.zarr"):
        with open_recording(tmp_path / name) as recording:
            assert recording.metadata["um_per_px"] == pytest.approx(0.9, rel=1e-5)
            assert recording.times_s == pytest.approx(0.005 * np.arange(7))


@pytest.mark.parametrize(
    ("unit", "period_s"), [("sec", 0.25), ("ms", 0.25e-3), ("\\u00B5s", 0.25e-6), ("min", 15.0), ("fortnights", None)]
)
def test_an_interval_of_imagej_is_in_its_unit(tmp_path, frames, unit, period_s):
    metadata = {"axes": "TYX", "finterval": 0.25, "tunit": unit}
    tifffile.imwrite(tmp_path / "a.tif", frames, imagej=True, metadata=metadata)
    with open_recording(tmp_path / "a.tif") as recording:
        assert recording.metadata.get("frame_period_s") == pytest.approx(period_s)


@pytest.mark.parametrize("axes", ["TCYX", "TZYX"])
@pytest.mark.parametrize("imagej", [True, False])
def test_channels_and_planes_are_no_moments(tmp_path, frames, axes, imagej):
    stack = frames[:6].reshape(3, 2, *frames.shape[1:])
    options = {"imagej": True} if imagej else {"ome": True}
    tifffile.imwrite(tmp_path / "a.ome.tif", stack, photometric="minisblack", metadata={"axes": axes}, **options)
    with pytest.raises(InputError, match="a stack of frames"):
        open_recording(tmp_path / "a.ome.tif")


def test_finite_floats_are_accepted_and_nan_is_refused(tmp_path, frames):
    floats = frames.astype(np.float64)
    floats[4, 2, 3] = np.nan
    tifffile.imwrite(tmp_path / "float.tif", floats)
    with open_recording(tmp_path / "float.tif") as recording:
        assert recording[0].dtype == np.float32
        with pytest.raises(InputError, match=r"frame 4 holds NaN"):
            recording[4]
        with pytest.raises(InputError, match=r"frame 4 holds NaN"):
            recording[:]


def test_a_closed_recording_says_so(tmp_path, frames):
    zlib_tiff(tmp_path / "a.tif", frames)
    recording = open_recording(tmp_path / "a.tif")
    recording.close()
    recording.close()
    with pytest.raises(InputError, match="closed"):
        recording[0]


@pytest.mark.parametrize("name", ["zlib.tif", "r.ome.tif", "video.avi"])
def test_a_recording_that_is_dropped_lets_go_of_its_file(tmp_path, frames, name):
    FORMATS[name](tmp_path / name, frames)
    gc.collect()
    gc.freeze()  # what other tests have left open is not told here
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            recording = open_recording(tmp_path / name)
            recording[0]
            recording.me = recording
            del recording
            gc.collect()
    finally:
        gc.unfreeze()
    assert [str(warning.message) for warning in caught] == []


@pytest.mark.skipif(not hasattr(os, "posix_fadvise"), reason="the system cannot be told what is read no more")
@pytest.mark.parametrize("name", ["r.ome.tif", "ome.ome.tif", "motorola.tif", "stack.npy"])
def test_of_a_long_recording_only_frames_read_in_turn_leave_the_systems_memory(tmp_path, frames, monkeypatch, name):
    released = []

    def release(descriptor, start, length, advice):
        assert advice == os.POSIX_FADV_DONTNEED
        assert os.fstat(descriptor).st_size >= start + length
        released.append(length)

    many, frame_bytes = np.concatenate([frames] * 10), frames[0].nbytes
    monkeypatch.setattr(os, "posix_fadvise", release)
    monkeypatch.setattr(stored_frames, "RELEASED_BYTES", 4 * frame_bytes)
    FORMATS[name](tmp_path / name, many)
    for part, step, expected in ((0, 1, len(many) - 5), (0, 2, 0), (1, 1, 0)):
        monkeypatch.setattr(stored_frames, "MAX_CACHED_PART", part)
        released.clear()
        with open_recording(tmp_path / name) as recording:
            for index in range(0, len(many), step):
                np.testing.assert_array_equal(recording[index], many[index])
        assert expected * frame_bytes <= sum(released) <= expected * (frame_bytes + 1024) * 1.1


@pytest.mark.skipif(os.name != "posix", reason="pages are released by the system")
@pytest.mark.parametrize("name", ["r.ome.tif", "ome.ome.tif", "stack.npy"])
def test_frames_that_were_read_do_not_stay_in_this_programs_memory(tmp_path, name):
    FORMATS[name](tmp_path / name, np.ones((160, 1024, 1024), np.uint8))
    before = psutil.Process().memory_info().rss
    with open_recording(tmp_path / name) as recording:
        assert sum(int(frame.sum()) for frame in recording) == 160 << 20
        assert psutil.Process().memory_info().rss - before < 80 << 20


@pytest.mark.skipif(not hasattr(os, "posix_fadvise"), reason="the system cannot be told to forget a file")
@pytest.mark.parametrize("is_cached", [True, False])
def test_times_are_read_without_the_frames_between(tmp_path, is_cached):
    FORMATS["r.ome.tif"](tmp_path / "r.ome.tif", np.ones((160, 1024, 1024), np.uint8))
    if not is_cached:
        with (tmp_path / "r.ome.tif").open("rb+") as file:
            os.fsync(file.fileno())
            os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
    with open_recording(tmp_path / "r.ome.tif") as recording:
        before = psutil.Process().memory_info().rss
        assert len(recording.times_s) == len(recording.frame_numbers) == 160
        assert psutil.Process().memory_info().rss - before < 4 << 20


@pytest.mark.skipif(os.name != "posix", reason="this system cuts no file that is open")
@pytest.mark.parametrize("name", ["r.ome.tif", "ome.ome.tif", "motorola.tif", "stack.npy"])
def test_frames_of_a_recording_that_was_cut_meanwhile_are_told(tmp_path, name):
    frames = np.random.default_rng(4).integers(0, 255, (9, 200, 300), np.uint8)
    FORMATS[name](tmp_path / name, frames)
    with open_recording(tmp_path / name) as recording:
        os.truncate(tmp_path / name, (tmp_path / name).stat().st_size // 2)
        np.testing.assert_array_equal(recording[1], frames[1])
        with pytest.raises(InputError, match=r"frame 8 cannot be read \(EOFError"):
            recording[8]


@pytest.mark.skipif(os.name != "posix", reason="this system cuts no file that is open")
def test_times_of_a_recording_that_was_cut_meanwhile_are_told_and_not_invented(tmp_path, frames):
    FORMATS["r.ome.tif"](tmp_path / "r.ome.tif", frames)
    with open_recording(tmp_path / "r.ome.tif") as recording:
        os.truncate(tmp_path / "r.ome.tif", (tmp_path / "r.ome.tif").stat().st_size // 2)
        with pytest.raises(InputError, match=r"r\.ome\.tif: the frames' times cannot be read"):
            _ = recording.times_s


def test_numbers_of_either_byte_order_are_read(tmp_path, frames):
    np.save(tmp_path / "big-endian.npy", frames.astype(">u2"))
    with open_recording(tmp_path / "big-endian.npy") as recording:
        assert recording.dtype == np.uint16
        np.testing.assert_array_equal(np.asarray(recording), frames)


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("compression", [None, "zlib"])
@pytest.mark.filterwarnings("ignore:.*photometric:DeprecationWarning")
def test_a_few_frames_written_as_an_array_are_frames_and_no_colours(tmp_path, count, dtype, compression):
    frames = np.random.default_rng(3).integers(0, 255, (count, 40, 64)).astype(dtype)
    tifffile.imwrite(tmp_path / "few.tif", frames, compression=compression)
    with open_recording(tmp_path / "few.tif") as recording:
        assert (recording.shape, recording.dtype) == (frames.shape, dtype)
        np.testing.assert_array_equal(np.asarray(recording), frames)


def write_bad(folder, name):
    path = folder / name
    whole = np.random.default_rng(2).integers(0, 255, (9, 40, 64), dtype=np.uint8)
    match name:
        case "empty.tif" | "empty.avi" | "empty.npy":
            path.write_bytes(b"")
        case "text.tif" | "text.avi" | "text.npy" | "text":
            path.write_text("not a recording")
        case "rgb.tif":
            tifffile.imwrite(path, np.zeros((3, 40, 60, 3), np.uint8))
        case "white.tif":
            tifffile.imwrite(path, whole, photometric="miniswhite")
        case "planes.tif":
            tifffile.imwrite(path, np.zeros((3, 40, 60), np.uint8), photometric="rgb", metadata=None)
        case "cut-planes.tif":
            with pytest.warns(DeprecationWarning, match="photometric"):
                tifffile.imwrite(path, whole[:3], compression="zlib")
            path.write_bytes(path.read_bytes()[:-50])
        case "rgb.npy":
            np.save(path, np.zeros((3, 40, 60, 3), np.uint8))
        case "colour.avi":
            red = np.full((2, 48, 64, 3), (250, 10, 10), np.uint8)
            write_avi(path, red, "-c:v", "mjpeg", pixels="rgb24")
        case "cut-pages.tif" | "cut-contiguous.tif" | "cut-last.tif":
            tifffile.imwrite(path, whole, compression=None if name == "cut-contiguous.tif" else "zlib")
            blob = path.read_bytes()
            path.write_bytes(blob[: len(blob) // 3] if name != "cut-last.tif" else blob[:-50])
        case "cut.npy":
            np.save(path, whole)
            path.write_bytes(path.read_bytes()[:-1])
        case "pickled.npy":
            np.save(path, np.array([{}], object), allow_pickle=True)
        case "signed.tif":
            tifffile.imwrite(path, whole.astype(np.int16))
        case "several.tif":
            with tifffile.TiffWriter(path) as writer:
                writer.write(whole[0])
                writer.write(whole[0][:10])
        case "nothing":
            path.mkdir()
        case "mixed":
            path.mkdir()
            tifffile.imwrite(path / "a1.tif", whole[0])
            tifffile.imwrite(path / "a2.tif", whole[0][:10])
        case "no-image.zarr":
            zarr.open_group(path, mode="w")
        case "absent.tif":
            pass
    return path


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes here")
@pytest.mark.parametrize("name", ["pipe", "pipe.npy", "pipe.tif"])
def test_a_pipe_is_refused_and_not_waited_for(tmp_path, name):
    os.mkfifo(tmp_path / name)
    with pytest.raises(InputError, match=f"{name} is a device or a pipe: name a file"):
        open_recording(tmp_path / name)


@pytest.mark.parametrize("options", [{"rowsperstrip": 16}, {"tile": (16, 16)}, {"compression": "zlib"}])
@pytest.mark.parametrize("tags", [("StripOffsets", "TileOffsets"), ("StripByteCounts", "TileByteCounts")])
def test_a_page_that_lacks_some_of_its_pixels_is_refused_and_not_read_as_black(tmp_path, options, tags):
    path = tmp_path / "pages.tif"
    with tifffile.TiffWriter(path) as writer:
        for frame in np.random.default_rng(3).integers(0, 255, (4, 40, 60), np.uint8):
            writer.write(frame, contiguous=False, metadata=None, **options)
    with tifffile.TiffFile(path, mode="r+") as file:
        tag = next(file.pages[2].tags[name] for name in tags if name in file.pages[2].tags)
        tag.overwrite((0, *tag.value[1:]))
    with open_recording(path) as recording:
        assert recording[1].any()
        with pytest.raises(InputError, match=r"pages\.tif: frame 2 lacks some of its pixels"):
            recording[2]


@pytest.mark.parametrize("compression", [None, "zlib"])
@pytest.mark.parametrize("other", [np.zeros((30, 60), np.uint16), np.zeros((40, 60), np.uint8)])
def test_a_page_of_another_size_or_depth_than_the_first_is_refused(tmp_path, other, compression):
    frames = list(np.random.default_rng(3).integers(0, 4095, (12, 40, 60), np.uint16))
    with tifffile.TiffWriter(tmp_path / "pages.tif") as writer:
        for frame in [*frames[:5], other, *frames[6:]]:
            writer.write(frame, contiguous=False, metadata=None, compression=compression)
    with open_recording(tmp_path / "pages.tif") as recording:
        np.testing.assert_array_equal(recording[6], frames[6])
        with pytest.raises(InputError, match=r"pages\.tif: frame 5 is stored otherwise than the first"):
            recording[5]


@pytest.mark.parametrize("options", [{"compression": "zlib"}, {"contiguous": False}, {"metadata": None}])
def test_a_tiff_written_frame_by_frame_is_one_stack(tmp_path, options):
    frames = np.random.default_rng(3).integers(0, 255, (7, 40, 60), np.uint8)
    with tifffile.TiffWriter(tmp_path / "pages.tif") as writer:
        for frame in frames:
            writer.write(frame, **options)
    with open_recording(tmp_path / "pages.tif") as recording:
        assert recording.shape == frames.shape
        np.testing.assert_array_equal(recording[5], frames[5])
        np.testing.assert_array_equal(recording[:], frames)


def test_a_cut_tiff_written_frame_by_frame_is_refused(tmp_path):
    path = tmp_path / "pages.tif"
    with tifffile.TiffWriter(path) as writer:
        for frame in np.random.default_rng(3).integers(0, 255, (7, 40, 60), np.uint8):
            writer.write(frame, compression="zlib")
    path.write_bytes(path.read_bytes()[:-4000])
    with pytest.raises(InputError, match="truncated"):
        open_recording(path)


@pytest.mark.parametrize(
    ("name", "said"),
    {
        "empty.tif": "is empty",
        "empty.avi": "is empty",
        "empty.npy": "is empty",
        "text.tif": "is no TIFF",
        "text.avi": "cannot be decoded",
        "text.npy": "cannot be read",
        "text": "is in no known format",
        "rgb.tif": "colour",
        "white.tif": "white as 0",
        "planes.tif": "colour",
        "cut-planes.tif": "truncated",
        "rgb.npy": r"shape \(3, 40, 60, 3\)",
        "colour.avi": "colour",
        "cut-pages.tif": "truncated",
        "cut-contiguous.tif": "truncated",
        "cut-last.tif": "truncated",
        "cut.npy": "cannot be read",
        "pickled.npy": "cannot be read",
        "signed.tif": "int16 pixels",
        "several.tif": "2 image series",
        "nothing": "holds no TIFF",
        "mixed": "a2.tif",
        "no-image.zarr": "multiscales",
        "absent.tif": "no file",
    }.items(),
)
def test_bad_recordings_are_refused_in_one_line(tmp_path, capfd, name, said):
    path = write_bad(tmp_path, name)
    with pytest.raises(InputError, match=said) as caught, open_recording(path) as recording:
        recording[:]
    assert "\n" not in str(caught.value)
    assert isinstance(caught.value, ElsPlusError)
    assert capfd.readouterr().err == ""
