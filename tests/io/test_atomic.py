"""A file is there in full or not at all."""

from __future__ import annotations

import os

import pytest

from napari_elsplus.errors import InputError
from napari_elsplus.io import replacing, replacing_all
from napari_elsplus.io.atomic import remove_unfinished


def names(folder):
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize("interruption", [KeyboardInterrupt, ValueError, SystemExit])
def test_whatever_interrupts_leaves_the_old_file_and_nothing_else(tmp_path, interruption):
    (tmp_path / "a.txt").write_text("old")

    def interrupted():
        with replacing(tmp_path / "a.txt", force=True) as beside:
            beside.write_text("half")
            raise interruption

    with pytest.raises(interruption):
        interrupted()
    assert names(tmp_path) == ["a.txt"]
    assert (tmp_path / "a.txt").read_text() == "old"


def test_the_target_appears_only_at_the_end(tmp_path):
    with replacing(tmp_path / "a.ome.tif") as beside:
        beside.write_text("new")
        assert not (tmp_path / "a.ome.tif").exists()
        assert beside.parent == tmp_path
        assert beside.suffixes[-2:] == [".ome", ".tif"]
    assert names(tmp_path) == ["a.ome.tif"]


def test_refusals_come_before_the_work(tmp_path):
    (tmp_path / "a").write_text("")
    (tmp_path / "folder").mkdir()
    for target, force, said in (("a", False, "exists"), ("folder", True, "folder"), ("absent/a", False, "no folder")):
        with pytest.raises(InputError, match=said), replacing(tmp_path / target, force=force):
            raise AssertionError("work was done")


def test_a_folder_is_flushed_to_the_disk_with_all_that_is_in_it(tmp_path, monkeypatch):
    flushed = []
    fsync = os.fsync
    monkeypatch.setattr(os, "fsync", lambda file: (flushed.append(os.fstat(file).st_ino), fsync(file)))
    with replacing(tmp_path / "a.zarr") as beside:
        (beside / "0").mkdir(parents=True)
        (beside / "zarr.json").write_text("{}")
        (beside / "0" / "c").write_text("chunk")
    written = [tmp_path / "a.zarr" / "zarr.json", tmp_path / "a.zarr" / "0" / "c"]
    assert {path.stat().st_ino for path in written} <= set(flushed)


def test_what_a_killed_process_left_beside_a_target_is_removed(tmp_path):
    (tmp_path / ".deadbeef.a.zarr" / "0").mkdir(parents=True)
    for name in (".deadbeef.a.tif", ".deadbeef.b.tif", "a.tif"):
        (tmp_path / name).write_text("")
    remove_unfinished(tmp_path / "a.zarr", tmp_path / "a.tif", tmp_path / "absent" / "c.tif")
    assert names(tmp_path) == [".deadbeef.b.tif", "a.tif"]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes here")
def test_a_device_or_a_pipe_is_not_replaced_by_a_file(tmp_path):
    """A rename would: run as root, /dev/null would be a file from then on."""
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="pipe is a device or a pipe"), replacing(tmp_path / "pipe", force=True):
        raise AssertionError("work was done")
    assert (tmp_path / "pipe").is_fifo()


def test_several_files_of_one_result_are_refused_together(tmp_path):
    (tmp_path / "b").write_text("mine")
    with pytest.raises(InputError, match="b exists"), replacing_all(tmp_path / "a", tmp_path / "b"):
        raise AssertionError("work was done")
    with replacing_all(tmp_path / "a", tmp_path / "b", force=True) as (first, second):
        first.write_text("1")
        second.write_text("2")
    assert (tmp_path / "a").read_text() + (tmp_path / "b").read_text() == "12"
    assert names(tmp_path) == ["a", "b"]


def test_a_folder_replaces_a_file_or_a_folder(tmp_path):
    (tmp_path / "image.zarr").write_text("no folder")
    for text in ("old", "new"):
        with replacing(tmp_path / "image.zarr", force=True) as beside:
            beside.mkdir()
            (beside / text).write_text(text)
    assert names(tmp_path / "image.zarr") == ["new"]


@pytest.mark.parametrize("existing", [True, False])
@pytest.mark.parametrize("name", ["a.zarr", "a.ome.tif"])
def test_a_link_is_replaced_and_what_it_names_stays(tmp_path, name, existing):
    """Under its own name, an earlier result is no output of this one; its folder may lie on another disk."""
    link, place = tmp_path / f"newest-{name}", tmp_path / "earlier" / name
    place.parent.mkdir()
    folder = name.endswith(".zarr")
    if existing:
        (place.mkdir if folder else place.touch)()
    try:
        link.symlink_to(place, target_is_directory=folder)
    except OSError:
        pytest.skip("no symbolic links here")
    with pytest.raises(InputError, match="exists"), replacing(link):
        raise AssertionError("work was done")
    with replacing(link, force=True) as beside:
        if folder:
            beside.mkdir()
            (beside / "zarr.json").write_text("new")
        else:
            beside.write_text("new")
    assert names(tmp_path) == ["earlier", link.name]
    assert not link.is_symlink()
    assert (link / "zarr.json" if folder else link).read_text() == "new"
    assert names(place.parent) == ([name] if existing else [])
    assert not existing or (names(place) == [] if folder else place.read_text() == "")
