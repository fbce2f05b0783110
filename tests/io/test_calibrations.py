"""A calibration survives its file, and a broken file is told in one line."""

from __future__ import annotations

import errno
import io
import json
import os
import pickle
import zipfile
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from napari_elsplus.errors import CalibrationError, ElsPlusError, InputError
from napari_elsplus.instrument.calibration import Calibration
from napari_elsplus.io import ImageMetadata, atomic, open_recording, read_calibration, write_calibration, write_images
from napari_elsplus.io.calibration_lookup import is_calibration
from napari_elsplus.io.calibrations import parse_calibration

FULL = {
    "format": "napari-elsplus/calibration",
    "version": 1,
    "created": "2026-01-31T12:00:00Z",
    "frame": {"shape": [20, 40], "sensor_origin": [0, 0]},
    "acquired_with": {"rig": "simulated", "objective": "10x", "slit_rows": 3.0, "frame_rate_hz": 240.0, "gain_db": 0.0},
    "offset": {"rows": -12.03, "uncertainty_rows": 0.01, "tilt_deg": 0.2},
    "galvo": {
        "volts_per_row": 0.00126, "volts_at_row_zero": -0.459, "r_squared": 0.9999, "rms_rows": 0.05, "lag_s": 2e-4,
        "park_v": -0.7,
    },
    "bundle": {
        "confocal_centre": [161.0, 158.0], "residual_centre": [149.0, 481.0], "diameter_px": 290.0,
        "residual_to_confocal": [[1.0, 0.0, 12.0], [0.0, 1.0, -323.0]], "residual_gain": 1.0,
        "residual_gain_uncertainty": 0.003,
    },
    "optics": {"um_per_px": 2.138, "line_period_s": 7.648e-06, "rows_per_frame": 544.8},
    "quality": {"alignment_error": 0.012, "alignment_error_filtered": 0.004},
}  # fmt: skip
ARRAYS = {"background": np.full((20, 40), 7.25, np.float32), "flat": np.ones((15, 15), np.float32)}


def test_everything_comes_back_and_unknown_keys_survive(tmp_path):
    content = FULL | {"operator": "Änne", "offset": FULL["offset"] | {"method": [1, {"deep": "x"}]}}
    calibration = Calibration.parse(content).model_copy(update=ARRAYS)
    write_calibration(tmp_path / "c.json", calibration)
    again = read_calibration(tmp_path / "c.json")
    assert again.content() == calibration.content() == content
    listed = {"arrays": ["background", "flat"]}
    assert json.loads((tmp_path / "c.json").read_text(encoding="utf-8")) == content | listed
    np.testing.assert_array_equal(again.background, ARRAYS["background"])
    np.testing.assert_array_equal(again.flat, ARRAYS["flat"])


DISTORTION = np.arange(20, dtype=np.float32).reshape(2, 10) / 100


def test_distortion_makes_a_file_of_version_2_that_is_not_read_without_it(tmp_path):
    calibration = Calibration.parse(FULL).model_copy(update=ARRAYS | {"distortion": DISTORTION})
    write_calibration(tmp_path / "c.json", calibration)
    assert json.loads((tmp_path / "c.json").read_text(encoding="utf-8")) == FULL | {
        "version": 2,
        "needs": ["distortion"],
        "arrays": ["background", "flat", "distortion"],
    }
    again = read_calibration(tmp_path / "c.json")
    np.testing.assert_array_equal(again.distortion, DISTORTION)
    assert again.content()["version"] == 2
    (tmp_path / "c.npz").unlink()
    with pytest.raises(CalibrationError, match=r"needs the distortion in c\.npz"):
        read_calibration(tmp_path / "c.json")
    np.savez(tmp_path / "c.npz", distortion=DISTORTION[:, :6])
    with pytest.raises(CalibrationError, match=r"distortion has shape \(2, 6\)"):
        read_calibration(tmp_path / "c.json")


def remove(path):
    path.unlink()


def keep_the_flat_field_alone(path):
    np.savez(path, flat=ARRAYS["flat"])


@pytest.mark.parametrize(
    ("spoil", "absent"), [(remove, "background and flat"), (keep_the_flat_field_alone, "background")]
)
def test_arrays_that_were_saved_with_the_record_and_are_absent_are_a_warning(tmp_path, spoil, absent):
    """They are worth some grey levels, or an option; the numbers hold without them."""
    path = write_calibration(tmp_path / "c.json", Calibration.parse(FULL).model_copy(update=ARRAYS))
    spoil(tmp_path / "c.npz")
    with pytest.warns(
        UserWarning, match=rf"c\.json was saved with {absent}, which c\.npz lacks: put .* calibrate again$"
    ) as said:
        left = read_calibration(path)
    assert len(said) == 1
    assert left.background is None
    assert left.content() == FULL
    write_calibration(path, left, force=True)  # from now on they are known to be absent
    assert read_calibration(path).content() == FULL


def test_what_is_read_without_its_file_of_arrays_lists_none(tmp_path):
    """Neither a record in a recording, nor one that never had arrays; and a list that is none is passed over."""
    known = Calibration.parse(FULL).model_copy(update=ARRAYS)
    write_images(tmp_path / "r.tif", [np.zeros((20, 40), np.uint8)], ImageMetadata(calibration=known))
    with open_recording(tmp_path / "r.tif") as recording:
        assert recording.calibration.content() == FULL
    for listed in ([], ["unknown", 3], 7, None, {"flat": 1}):
        (tmp_path / "c.json").write_text(json.dumps(FULL | {"arrays": listed}))
        assert read_calibration(tmp_path / "c.json").content() == FULL


FROZEN = """{
 "format": "napari-elsplus/calibration", "version": 1, "created": "2026-01-31T12:00:00Z",
 "frame": {"shape": [4, 6], "sensor_origin": [0, 0]},
 "offset": {"rows": -12.03, "uncertainty_rows": 0.01, "tilt_deg": 0.2},
 "galvo": {"volts_per_row": 0.00126, "volts_at_row_zero": -0.459, "r_squared": 0.9999, "rms_rows": 0.05, "lag_s": 0.0},
 "bundle": {"confocal_centre": [161.0, 158.0], "residual_centre": [149.0, 481.0], "diameter_px": 290.0,
            "residual_to_confocal": [[1.0, 0.0, 12.0], [0.0, 1.0, -323.0]], "residual_gain": 1.0},
 "optics": {"um_per_px": 2.138, "line_period_s": 7.648e-06, "rows_per_frame": 544.8}}"""
"""A file of version 1 as it was written; never to be changed."""


def test_a_frozen_file_of_version_1_opens_for_ever(tmp_path):
    (tmp_path / "old.json").write_text(FROZEN)
    np.savez(tmp_path / "old.npz", background=np.full((4, 6), 5.0, np.float32), flat=np.ones((3, 3), np.float32))
    old = read_calibration(tmp_path / "old.json")
    assert old.version == 1
    assert old.distortion is None
    assert old.offset.rows == -12.03
    assert old.bundle.residual_to_confocal[1] == (0.0, 1.0, -323.0)
    assert old.background[0, 0] == 5.0


def test_arrays_that_no_longer_belong_are_removed(tmp_path):
    bare = Calibration.parse(FULL)
    write_calibration(tmp_path / "c.json", bare.model_copy(update=ARRAYS))
    with pytest.raises(InputError, match="exists"):
        write_calibration(tmp_path / "c.json", bare)
    assert read_calibration(tmp_path / "c.json").background is not None
    write_calibration(tmp_path / "c.json", bare, force=True)
    assert read_calibration(tmp_path / "c.json").background is None
    assert [path.name for path in tmp_path.iterdir()] == ["c.json"]


def test_arrays_of_a_record_that_cannot_be_replaced_stay(tmp_path, monkeypatch):
    """Before: they were removed, and the record was left without its background."""
    whole = Calibration.parse(FULL).model_copy(update=ARRAYS)
    path = write_calibration(tmp_path / "c.json", whole)

    def refuse(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as full:
        full.setattr(atomic, "put_in_place", refuse)
        with pytest.raises(OSError, match="No space"):
            write_calibration(path, Calibration.parse(FULL), force=True)
    assert read_calibration(path) == whole


BAD = {
    "NaN": '{"offset": {"rows": NaN, "uncertainty_rows": 1}}',
    "Infinity": '{"unknown": Infinity}',
    "1e999 is out of range": '{"unknown": 1e999}',
    "no napari-elsplus/calibration record": "[]",
    "this is no napari-elsplus/calibration record": "{}",
    "version 999": '{"format": "napari-elsplus/calibration", "version": 999}',
    "residual_gain": json.dumps(FULL | {"bundle": FULL["bundle"] | {"residual_gain": 3.0}}),
    "diameter_px": json.dumps(FULL | {"bundle": FULL["bundle"] | {"diameter_px": 1e308}}),
    "um_per_px": json.dumps(FULL | {"optics": {"um_per_px": 1e308}}),
    "c.json is no calibration": "not json",
    "is no calibration": "[" * 100_000,
    "Expecting value": "",
}


@pytest.mark.parametrize(("said", "text"), BAD.items())
def test_bad_records_are_refused_in_one_line(tmp_path, said, text):
    (tmp_path / "c.json").write_text(text)
    with pytest.raises(CalibrationError, match=said) as caught:
        read_calibration(tmp_path / "c.json")
    assert "\n" not in str(caught.value)


def test_files_that_are_no_text_missing_or_huge(tmp_path):
    (tmp_path / "b.json").write_bytes(b"\xff\xfe\x00")
    with (tmp_path / "huge.json").open("wb") as file:
        file.truncate(1 << 40)
    for path in ("b.json", "huge.json", "absent.json", "."):
        with pytest.raises(CalibrationError):
            read_calibration(tmp_path / path)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes here")
def test_a_pipe_or_a_device_is_not_waited_for(tmp_path):
    """A pipe that nobody writes to was waited for without end, and of a device all memory was filled."""
    os.mkfifo(tmp_path / "pipe.json")
    for path in (tmp_path / "pipe.json", "/dev/zero"):
        assert not is_calibration(path)
        with pytest.raises(CalibrationError, match="is no file"):
            read_calibration(path)


def pickled(path):
    np.savez(path, background=np.array([{}], object))


def other_shape(path):
    np.savez(path, background=np.zeros((3, 3)))


def with_nan(path):
    np.savez(path, flat=np.full((3, 3), np.nan))


def text(path):
    path.write_text("no archive")


def complex_numbers(path):
    np.savez(path, flat=np.zeros((3, 3), complex))


def spoilt(path):
    """Write bytes that zlib does not unpack."""
    np.savez_compressed(path, background=np.zeros((20, 40), np.float32))
    data = bytearray(path.read_bytes())
    start = data.index(b".npy") + len(b".npy") + 20  # past the member's extra field
    data[start : start + 8] = b"\xff" * 8
    path.write_bytes(data)


def open_bracket(path):
    """Write a header that Python's tokenizer, which numpy asks, does not end."""
    member = io.BytesIO()
    np.save(member, np.zeros((20, 40), np.float32))
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("background.npy", member.getvalue().replace(b"(20, 40)", b"(20, 40("))


def forged_header(shape, descr="<f8", fortran_order=False):
    """Return a writer of a .npz whose array's header declares more than the archive holds."""

    def write(path):
        member = io.BytesIO()
        np.lib.format.write_array_header_1_0(member, {"descr": descr, "fortran_order": fortran_order, "shape": shape})
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("background.npy", member.getvalue() + bytes(800))

    return write


class Payload:
    """Makes a folder when it is unpickled."""

    def __init__(self, folder):
        self.folder = str(folder)

    def __reduce__(self):
        return os.mkdir, (self.folder,)


def test_untrusted_arrays_are_never_unpickled(tmp_path):
    (tmp_path / "c.json").write_text(json.dumps(FULL))
    hostile = np.array([Payload(tmp_path / "executed")], object)
    np.savez(tmp_path / "c.npz", background=hostile, flat=hostile, unknown=hostile)
    np.save(tmp_path / "a.npy", hostile)
    (tmp_path / "b.npy").write_bytes(pickle.dumps(hostile))
    for name in ("c.json", "a.npy", "b.npy"):
        with pytest.raises(ElsPlusError):
            (read_calibration if name == "c.json" else open_recording)(tmp_path / name)
    assert not (tmp_path / "executed").exists()


FORGED = {
    "3.6 TiB": forged_header((704_000, 704_000)),
    "more than 64 bits": forged_header((1 << 40, 1 << 40)),
    "one more value than there is": forged_header((1, 101)),
    "fewer values than there are": forged_header((1, 99)),
    "negative": forged_header((-10, -10)),
    "wide strings": forged_header((1, 1), "<U1000000000"),
}


@pytest.mark.parametrize("write", FORGED.values(), ids=FORGED)
def test_forged_array_headers_are_refused_before_memory_is_allocated(tmp_path, write, monkeypatch):
    monkeypatch.setattr(np.lib.format, "read_array", lambda *_, **__: pytest.fail("memory was allocated"))
    content = {name: part for name, part in FULL.items() if name != "frame"}
    (tmp_path / "c.json").write_text(json.dumps(content))
    write(tmp_path / "c.npz")
    with pytest.raises(CalibrationError, match=r"c\.npz") as caught:
        read_calibration(tmp_path / "c.json")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("write", [pickled, other_shape, with_nan, text, complex_numbers, spoilt, open_bracket])
def test_bad_arrays_are_refused(tmp_path, write):
    (tmp_path / "c.json").write_text(json.dumps(FULL))
    write(tmp_path / "c.npz")
    with pytest.raises(CalibrationError, match=r"c\.npz"):
        read_calibration(tmp_path / "c.json")


def test_a_file_that_is_no_archive_is_said_to_hold_no_arrays(tmp_path):
    (tmp_path / "c.json").write_text(json.dumps(FULL))
    text(tmp_path / "c.npz")
    with pytest.raises(CalibrationError, match=r"c\.npz holds no named arrays"):
        read_calibration(tmp_path / "c.json")


@given(st.binary(max_size=12), st.integers(0, 1000), st.integers(0, 30))
def test_mutated_json_raises_nothing_but_our_own_errors(noise, place, cut):
    blob = json.dumps(FULL).encode()
    place %= len(blob)
    mutated = (blob[:place] + noise + blob[place + cut :]).decode("utf-8", "replace")
    with suppress(ElsPlusError):
        json.dumps(parse_calibration(mutated).content(), allow_nan=False)
