"""What is remembered between runs."""

from __future__ import annotations

import os

import pytest

from napari_elsplus.io import settings
from napari_elsplus.io.user_folders import CONFIG_VARIABLE


def test_sections_keep_to_themselves():
    settings.remember("rig", name="simulated", gains=[1.0, 2.0])
    settings.remember("view", name="dark")
    settings.remember("rig", preset="240hz", gains=None)
    assert settings.recall("rig") == {"name": "simulated", "preset": "240hz"}
    assert settings.recall("view") == {"name": "dark"}
    assert settings.recall("nothing") == {}


def test_what_does_not_change_is_not_written(monkeypatch):
    """A disk that is busy with a recording lets the window wait for each write."""
    settings.remember("view", name="dark", gone=None)
    written = settings.settings_file().stat().st_mtime_ns
    monkeypatch.setattr(settings, "replacing", None)
    settings.remember("view", name="dark", gone=None)
    assert settings.recall("view") == {"name": "dark"}
    assert settings.settings_file().stat().st_mtime_ns == written


def test_the_active_calibration_is_forgotten_when_its_file_goes(tmp_path):
    assert settings.active_calibration() is None
    path = tmp_path / "c.json"
    path.write_text("{}")
    settings.set_active_calibration(path)
    assert settings.active_calibration() == path
    path.unlink()
    assert settings.active_calibration() is None
    path.write_text("{}")
    settings.set_active_calibration(None)
    assert settings.active_calibration() is None


def test_the_key_of_earlier_versions_is_read_and_then_replaced(tmp_path):
    before, after = tmp_path / "before.json", tmp_path / "after.json"
    before.write_text("{}")
    after.write_text("{}")
    settings.remember("calibration", in_force=str(before))
    assert settings.active_calibration() == before
    settings.set_active_calibration(after)
    assert settings.active_calibration() == after
    assert settings.recall("calibration") == {"active": str(after)}


def test_a_broken_file_costs_the_memory_but_not_the_work():
    settings.remember("rig", name="simulated")
    settings.settings_file().write_text("not [ toml")
    with pytest.warns(UserWarning, match="could not be read"):
        assert settings.recall("rig") == {}


@pytest.mark.parametrize("broken", [b"not [ toml", b"[rig]\nname = '\xff'\n"])
def test_a_broken_file_is_kept_beside_the_new_one(broken):
    """Its other sections could be mended: they were lost with the next value that was remembered."""
    path = settings.settings_file()
    for name in ("settings.broken-1.toml", "settings.broken-2.toml"):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(broken)
        with pytest.warns(UserWarning, match=rf"could not be read.* kept as {name}") as caught:
            settings.remember("view", name="dark")
        assert [str(warning.message).count("\n") for warning in caught] == [0]
        assert path.with_name(name).read_bytes() == broken
        assert settings.recall("view") == {"name": "dark"}
        assert settings.recall("rig") == {}


def test_a_folder_in_the_place_of_the_file_is_kept_beside_it():
    path = settings.settings_file()
    (path / "inside").mkdir(parents=True)
    with pytest.warns(UserWarning, match=r"kept as settings\.broken-1\.toml"):
        settings.remember("view", name="dark")
    assert (path.with_name("settings.broken-1.toml") / "inside").is_dir()
    assert settings.recall("view") == {"name": "dark"}


def test_a_broken_file_that_cannot_be_kept_beside_stays(monkeypatch):
    settings.remember("rig", name="simulated")
    path = settings.settings_file()
    path.write_text("not [ toml")

    def refuse(*_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("pathlib.Path.rename", refuse)
    with pytest.warns(UserWarning, match="could not be kept"):
        settings.remember("view", name="dark")
    assert path.read_text() == "not [ toml"


def test_a_folder_that_cannot_be_written_is_said(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv(CONFIG_VARIABLE, str(tmp_path / "file" / "folder"))
    with pytest.warns(UserWarning, match="could not be kept"):
        settings.remember("rig", name="simulated")


def test_a_folder_that_may_not_be_written_is_said_too(monkeypatch):
    """Before: an error, which ended what remembered something by the way."""
    settings.remember("rig", name="simulated")
    monkeypatch.setattr(os, "access", lambda *_: False)
    with pytest.warns(UserWarning, match="could not be kept"):
        settings.remember("rig", name="other")
    assert settings.recall("rig") == {"name": "simulated"}
