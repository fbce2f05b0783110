from __future__ import annotations

import os
from pathlib import Path
from types import SimpleNamespace

import pytest

from napari_elsplus.diagnosis import devices
from napari_elsplus.diagnosis.finding import Level


@pytest.fixture
def camera_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """One camera of the maker on bus 2, address 5, whose device file is this."""
    camera = SimpleNamespace(bus=2, address=5)
    monkeypatch.setattr("usb.backend.libusb1.get_backend", object)
    monkeypatch.setattr("usb.core.find", lambda **wanted: [camera] if wanted["idVendor"] == 0x1E10 else [])
    monkeypatch.setattr(devices, "DEVICE_FILES", tmp_path)
    file = tmp_path / "002" / "005"
    file.parent.mkdir()
    file.touch()
    return file


def test_without_libusb_the_remedy_installs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("usb.backend.libusb1.get_backend", lambda: None)
    monkeypatch.setattr(devices.sys, "platform", "linux")
    (finding,) = devices.usb()
    assert (finding.level, finding.remedy) == (Level.WARNING, "apt-get install libusb-1.0-0")


def test_a_camera_that_may_be_opened_is_counted(camera_file: Path) -> None:
    (finding,) = devices.usb()
    assert finding.level is Level.OK
    assert "1 USB device" in finding.what


def test_a_camera_that_may_not_be_opened_gets_its_udev_line(camera_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "access", lambda file, mode: False)
    _, finding = devices.usb()
    assert finding.level is Level.WARNING
    assert str(camera_file) in finding.what
    assert 'ATTR{idVendor}=="1e10"' in finding.remedy


def test_nis_driver_is_told_with_its_version(monkeypatch: pytest.MonkeyPatch) -> None:
    system = SimpleNamespace(driver_version=SimpleNamespace(major_version=25, minor_version=3))
    monkeypatch.setattr("nidaqmx.system.System.local", staticmethod(lambda: system))
    (finding,) = devices.galvo_card()
    assert (finding.level, finding.what) == (Level.OK, "NI-DAQmx 25.3")


def test_without_nis_driver_the_rest_still_works(monkeypatch: pytest.MonkeyPatch) -> None:
    from nidaqmx.errors import DaqNotFoundError

    def absent() -> None:
        raise DaqNotFoundError("Could not find an installation of NI-DAQmx. Please ...")

    monkeypatch.setattr("nidaqmx.system.System.local", staticmethod(absent))
    (finding,) = devices.galvo_card()
    assert finding.level is Level.WARNING
    assert "simulated rig" in finding.remedy
