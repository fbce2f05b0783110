"""A file is there in full or not at all."""

from __future__ import annotations

import errno
import os
import shutil
from contextlib import suppress
from pathlib import Path

import pytest

from napari_elsplus.errors import InputError
from napari_elsplus.io import refuse_existing, replacing
from napari_elsplus.io.atomic import in_folder, real_path, remove_unfinished


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


def test_a_folder_that_is_no_zarr_is_not_replaced_whatever_its_name(tmp_path):
    """It was removed with all that was in it."""
    folder = tmp_path / "patients.zarr"
    folder.mkdir()
    (folder / "notes.txt").write_text("of the day")
    with pytest.raises(InputError, match="no Zarr that could be replaced"), replacing(folder, force=True):
        pass
    assert names(folder) == ["notes.txt"]


def test_a_folder_replaces_a_file_or_a_folder(tmp_path):
    (tmp_path / "image.zarr").write_text("no folder")
    for text in ("old", "new"):
        with replacing(tmp_path / "image.zarr", force=True) as beside:
            beside.mkdir()
            (beside / text).write_text(text)
            (beside / "zarr.json").write_text("{}")
    assert names(tmp_path / "image.zarr") == ["new", "zarr.json"]


@pytest.mark.parametrize("interruption", [KeyboardInterrupt, OSError])
def test_the_folder_to_replace_stays_where_the_new_one_cannot_take_its_place(tmp_path, monkeypatch, interruption):
    """Before: the old one was removed first, which takes seconds, and an interruption then lost both."""
    target, rename = tmp_path / "image.zarr", Path.replace
    target.mkdir()
    (target / "zarr.json").write_text("old")

    def interrupted(path, to):
        if to == target and names(path) == ["new"]:
            raise interruption
        return rename(path, to)

    def replaced():
        with replacing(target, force=True) as beside:
            beside.mkdir()
            (beside / "new").touch()
            monkeypatch.setattr(Path, "replace", interrupted)

    with pytest.raises(interruption):
        replaced()
    assert names(tmp_path) == ["image.zarr"]
    assert (target / "zarr.json").read_text() == "old"


@pytest.mark.parametrize("interruption", [KeyboardInterrupt, OSError])
def test_of_a_folder_that_is_replaced_the_new_one_stays_where_the_old_one_cannot_be_removed(
    tmp_path, monkeypatch, interruption
):
    """Before: a part of the old one stayed, and the new one was removed."""
    target, remove = tmp_path / "image.zarr", shutil.rmtree
    target.mkdir()
    (target / "zarr.json").write_text("old")
    failing = [interruption]

    def interrupted(path):
        if failing:
            raise failing.pop()
        remove(path)

    def replaced():
        with replacing(target, force=True) as beside:
            beside.mkdir()
            (beside / "new").touch()
            monkeypatch.setattr(shutil, "rmtree", interrupted)

    with suppress(interruption):
        replaced()
    assert names(target) == ["new"]


@pytest.mark.skipif(os.name != "posix", reason="a folder is not opened there")
def test_a_folder_that_may_be_written_but_not_read_takes_a_file(tmp_path, monkeypatch):
    """Before: an error, after the file had taken its place."""

    def refused(folder, _):
        raise PermissionError(errno.EACCES, "Permission denied", str(folder))

    monkeypatch.setattr(os, "open", refused)
    with replacing(tmp_path / "a.txt") as beside:
        beside.write_text("new")
    assert (tmp_path / "a.txt").read_text() == "new"


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


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), OSError("6 requested and 4 written")])
def test_an_error_of_the_disk_names_the_file_that_was_to_be_written(tmp_path, error):
    """Before: it named none, or one that was nobody's."""

    with pytest.raises(OSError, match=r"not all of it|No space") as raised, replacing(tmp_path / "a.txt"):
        raise error
    assert raised.value.filename == str(tmp_path / "a.txt")
    assert raised.value.errno == error.errno


def test_the_file_beside_is_not_named_but_others_are(tmp_path):
    def opened(name):
        with replacing(tmp_path / "a.zarr") as beside:
            (beside / name if name else tmp_path / "other").read_text()

    for name, named in (("0", tmp_path / "a.zarr"), ("", tmp_path / "other")):
        with pytest.raises(FileNotFoundError) as raised:
            opened(name)
        assert raised.value.filename == str(named)


def test_a_folder_that_may_not_be_written_is_refused_before_the_work(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "access", lambda path, mode: not (str(path) == str(tmp_path) and mode == os.W_OK))
    with pytest.raises(InputError, match=f"the folder {tmp_path} may not be written"), replacing(tmp_path / "a"):
        raise AssertionError("work was done")


def test_a_folder_for_files_that_were_not_written_is_not_left(tmp_path):
    def failing(folder, written):
        with in_folder(folder):
            for name in written:
                (folder / name).write_text("")
            raise ZeroDivisionError

    (tmp_path / "old").mkdir()
    for folder, written in (("old", ()), ("new/folder", ()), ("kept", ("a",))):
        with pytest.raises(ZeroDivisionError):
            failing(tmp_path / folder, written)
    assert names(tmp_path) == ["kept", "old"]


@pytest.mark.skipif(os.name == "nt", reason="links need rights on Windows")
def test_links_in_a_circle_have_a_path(tmp_path):
    (tmp_path / "a").symlink_to("b")
    (tmp_path / "b").symlink_to("a")
    assert real_path(tmp_path / "a").parent == tmp_path.resolve()


@pytest.mark.parametrize("letter", ["a", "é"])
def test_a_name_as_long_as_a_file_system_takes_is_written(tmp_path, letter):
    longest = letter * ((255 - len(".ome.tif")) // len(letter.encode())) + ".ome.tif"
    with replacing(tmp_path / longest) as beside:
        assert beside.name.endswith(f"{letter}.ome.tif")
        beside.write_text("whole")
    assert names(tmp_path) == [longest]


def test_a_longer_name_is_refused_before_the_work(tmp_path):
    with pytest.raises(InputError, match="is a name of 256 bytes: give one of at most 255"):
        refuse_existing(tmp_path / ("é" * 126 + ".tif"))


def test_a_file_in_place_of_a_folder_is_refused(tmp_path):
    (tmp_path / "demo").write_text("")
    with pytest.raises(InputError, match="demo is a file: name a folder"), in_folder(tmp_path / "demo"):
        raise AssertionError("work was done")
