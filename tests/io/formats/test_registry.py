"""Every part that names file formats uses the one registry."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
import tifffile
import yaml

import napari_elsplus
from napari_elsplus.errors import InputError
from napari_elsplus.io import FileFormat, beside, calibration_beside, open_recording, register_format, write_calibration
from napari_elsplus.io.formats import registry
from napari_elsplus.io.formats.npy import NumpyFile
from pairs import calibration

HEAVY = ("tifffile", "zarr", "imageio_ffmpeg", "imagecodecs", "napari", "qtpy")


@pytest.fixture
def manifest():
    package = napari_elsplus.__path__[0]
    with open(f"{package}/napari.yaml", encoding="utf-8") as file:
        return yaml.safe_load(file)["contributions"]


@pytest.fixture
def clean_registry(monkeypatch):
    monkeypatch.setattr(registry, "_registered", dict(registry._registered))


def test_the_manifest_reads_and_writes_the_registered_suffixes(manifest):
    readable = [one for one in registry.file_formats() if one.opener]
    suffixes = {suffix for one in (*readable, registry.CALIBRATION) for suffix in one.suffixes}
    (reader,) = manifest["readers"]
    assert {pattern.removeprefix("*") for pattern in reader["filename_patterns"]} == suffixes
    assert reader["accepts_directories"] == any(one.is_folder for one in readable)
    declared = {tuple(writer["filename_extensions"]) for writer in manifest["writers"]}
    assert declared == {one.written_suffixes for one in registry.file_formats() if one.written_suffixes}


def suffixes():
    return sorted({suffix for one in registry.file_formats() for suffix in one.suffixes})


@pytest.mark.parametrize("suffix", suffixes())
@pytest.mark.parametrize("ome", ["", ".ome"])
def test_the_calibration_beside_is_found_whatever_the_suffix(tmp_path, ome, suffix):
    path = tmp_path / f"scan{ome}{suffix}"
    written = write_calibration(beside(path, ".calibration.json"), calibration())
    assert written.name == "scan.calibration.json"
    assert calibration_beside(path) == written


def test_files_that_earlier_versions_wrote_beside_a_btf_are_found(tmp_path):
    written = write_calibration(tmp_path / "scan.btf.calibration.json", calibration())
    assert calibration_beside(tmp_path / "scan.btf") == written


def test_file_dialogs_offer_every_file_that_can_be_read():
    offered = registry.recordings_filter()
    for one in registry.file_formats():
        assert all((f"*{suffix}" in offered) != one.is_folder for suffix in one.suffixes)


def test_help_names_every_readable_format():
    assert all(one.name in registry.supported_recordings() for one in registry.file_formats() if one.opener)


def test_a_file_without_a_known_suffix_is_opened_by_its_first_bytes(tmp_path):
    frames = np.arange(80, dtype=np.uint8).reshape(2, 5, 8)
    tifffile.imwrite(tmp_path / "a.dat", frames)
    np.save(tmp_path / "b.npy", frames)
    (tmp_path / "b.npy").rename(tmp_path / "b")
    for name in ("a.dat", "b"):
        with open_recording(tmp_path / name) as recording:
            np.testing.assert_array_equal(recording[:], frames)
    (tmp_path / "c.dat").write_bytes(b"neither")
    with pytest.raises(InputError, match=r"no known format: name one of: TIFF \(.tif .tiff .btf\)"):
        open_recording(tmp_path / "c.dat")


def test_a_suffix_that_no_format_writes_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"\.ome\.tif, \.tif"):
        registry.format_to_write(tmp_path / "a.avi")


@pytest.mark.usefixtures("clean_registry")
@pytest.mark.parametrize(
    "bad",
    [
        FileFormat("TIFF", (".other",), NumpyFile),
        FileFormat("other", (".tif",), NumpyFile),
        FileFormat("other", (".BIN",), NumpyFile),
        FileFormat("other", ("bin",), NumpyFile),
    ],
)
def test_conflicting_formats_are_refused(bad):
    before = registry.file_formats()
    with pytest.raises(ValueError, match="format"):
        register_format(bad)
    assert registry.file_formats() == before
    assert register_format(before[0]) is before[0]  # the same once more


def test_installed_packages_add_formats_by_an_entry_point(tmp_path):
    """In a process of its own: a distribution with a format, and one whose import fails."""
    for name, target in (("good", "good:FORMAT"), ("broken", "absent:FORMAT")):
        info = tmp_path / f"{name}-1.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1\n")
        (info / "entry_points.txt").write_text(f"[napari_elsplus.file_formats]\n{name} = {target}\n")
    (tmp_path / "good.py").write_text(
        "from napari_elsplus.io import FileFormat\nFORMAT = FileFormat('good', ('.good',), lambda path: None)\n"
    )
    code = (
        f"import sys, warnings; sys.path.insert(0, {str(tmp_path)!r})\n"
        "from napari_elsplus.io.formats.registry import recording_stem\n"
        "with warnings.catch_warnings(record=True) as caught:\n"
        "    warnings.simplefilter('always'); print(recording_stem('a.good'), len(caught), caught[0].message)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("a 1 the file format absent:FORMAT is not available")


@pytest.mark.parametrize(
    ("module", "absent"),
    [("user_folders", ("numpy", *HEAVY)), ("settings", ("numpy", *HEAVY)), ("formats.registry", HEAVY)],
)
def test_importing_loads_no_decoder(module, absent):
    code = f"import napari_elsplus.io.{module}, sys; print([name for name in {absent!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
