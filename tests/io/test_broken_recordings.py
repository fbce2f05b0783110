"""Whatever is done to a file's bytes, a reader raises one of our errors or gives frames."""

from __future__ import annotations

import io
import json
import os
import pickle

import numpy as np
import pytest
import tifffile
import zarr
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from napari_elsplus.errors import ElsPlusError, InputError
from napari_elsplus.io import RecordingWriter, open_recording

FRAMES = np.random.default_rng(5).integers(0, 255, (4, 24, 32), dtype=np.uint8)


def recorded(folder):
    with RecordingWriter(folder / "r.tif", (24, 32), np.uint8) as writer:
        for k, frame in enumerate(FRAMES):
            writer.append(frame, k / 240, k)
    return (folder / "r.tif").read_bytes()


def written(folder, **options):
    tifffile.imwrite(folder / "w.tif", FRAMES, **options)
    return (folder / "w.tif").read_bytes()


def numpy_file(_):
    file = io.BytesIO()
    np.save(file, FRAMES)
    return file.getvalue()


KINDS = {
    "recorded.tif": recorded,
    "plain.tif": written,
    "zlib.tif": lambda folder: written(folder, compression="zlib", predictor=True),
    "lzw.tif": lambda folder: written(folder, compression="lzw", tile=(16, 16)),
    "ome.tif": lambda folder: written(folder, ome=True, metadata={"axes": "TYX", "PhysicalSizeX": 0.9}),
    "imagej.tif": lambda folder: written(folder, imagej=True),
    "stack.npy": numpy_file,
}


class Payload:
    """Makes a folder when it is unpickled."""

    def __init__(self, folder):
        self.folder = str(folder)

    def __reduce__(self):
        return os.mkdir, (self.folder,)


@pytest.mark.parametrize("codec", [{"compressor": {"id": "pickle"}}, {"filters": [{"id": "pickle"}]}, {"dtype": "|O"}])
def test_chunks_of_a_zarr_are_never_unpickled(tmp_path, codec):
    path = tmp_path / "a.zarr"
    zarr.create_array(path, shape=(1, 24, 32), chunks=(1, 24, 32), dtype="u1", zarr_format=2, compressors=None)
    header = json.loads((path / ".zarray").read_text()) | codec
    if "dtype" in codec:
        header["filters"] = [{"id": "pickle"}]
    (path / ".zarray").write_text(json.dumps(header))
    (path / "0.0.0").write_bytes(pickle.dumps(Payload(tmp_path / "executed")))
    with pytest.raises(ElsPlusError), open_recording(path) as recording:
        recording[0]
    assert not (tmp_path / "executed").exists()


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole")
    return {name: write(folder) for name, write in KINDS.items()}


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", KINDS)
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_mutated_bytes_raise_nothing_but_our_own_errors(tmp_path, whole, name, data):
    blob = bytearray(whole[name])
    header = min(600, len(blob))
    for _ in range(data.draw(st.integers(1, 4))):
        place = data.draw(st.one_of(st.integers(0, header - 1), st.integers(0, len(blob) - 1)))
        blob[place] = data.draw(st.one_of(st.integers(0, 255), st.sampled_from([0, 1, 127, 128, 255])))
    cut = data.draw(st.one_of(st.just(len(blob)), st.integers(0, len(blob))))
    path = tmp_path / name
    path.write_bytes(blob[:cut])
    try:
        with open_recording(path) as recording:
            recording[0]
            recording[-1]
            assert recording.times_s is None or len(recording.times_s) == len(recording)
            assert len(recording.frame_numbers) == len(recording)
    except ElsPlusError as error:
        said = str(error)
        assert "\n" not in said


def test_a_number_of_frames_that_no_disk_holds_is_refused(tmp_path):
    """A Zarr of a few bytes declares what it likes: the chunks of its frames filled the memory of napari."""
    shape = (10**9, 300, 600)
    zarr.create_array(str(tmp_path / "huge.zarr"), shape=shape, chunks=(1, 300, 600), dtype="u1")
    with pytest.raises(InputError, match="declares 1000000000 frames"):
        open_recording(tmp_path / "huge.zarr")
