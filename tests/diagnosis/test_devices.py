"""The doctor's list of devices, on a virtual bus and with rigs' files made for it."""

from __future__ import annotations

import os
from pathlib import Path
from types import SimpleNamespace

import pytest

from napari_elsplus.diagnosis import devices
from napari_elsplus.diagnosis.finding import Level
from napari_elsplus.hardware.virtual.camera.bus import Plug, VirtualBus
from napari_elsplus.hardware.virtual.camera.device import VirtualCamera
from napari_elsplus.hardware.virtual.timeline import BenchClock


@pytest.fixture
def plug(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Plug:
    """One camera on the bus; no device file stands for it yet."""
    camera = VirtualCamera(SimpleNamespace(clock=BenchClock()), serial="4711")
    plugged = Plug(camera)
    monkeypatch.setattr("usb.backend.libusb1.get_backend", lambda: VirtualBus(plugged))
    monkeypatch.setattr(devices, "DEVICE_FILES", tmp_path)
    return plugged


@pytest.fixture
def camera_file(plug: Plug, tmp_path: Path) -> Path:
    file = tmp_path / "001" / "001"
    file.parent.mkdir()
    file.touch()
    return file


def test_without_libusb_the_remedy_installs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("usb.backend.libusb1.get_backend", lambda: None)
    monkeypatch.setattr(devices.sys, "platform", "linux")
    (finding,) = devices.usb()
    assert (finding.level, finding.remedy) == (Level.WARNING, "apt-get install libusb-1.0-0")


def test_a_camera_that_may_be_opened_is_named(camera_file: Path) -> None:
    count, camera = devices.usb()
    assert [count.level, camera.level] == [Level.OK, Level.OK]
    assert "1 USB3 Vision camera" in count.what
    assert "virtual camera, serial 4711 (1e10:3300)" in camera.what


def test_a_camera_that_may_not_be_opened_gets_its_udev_line(camera_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "access", lambda file, mode: False)
    monkeypatch.setattr(devices.sys, "platform", "linux")
    _, finding = devices.usb()
    assert finding.level is Level.WARNING
    assert str(camera_file) in finding.what
    assert 'ATTR{idVendor}=="1e10"' in finding.remedy


def test_where_there_are_no_device_files_the_bus_itself_says_no(plug: Plug, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("napari_elsplus.hardware.u3v.discovery.sys.platform", "win32")
    plug.forbidden = True
    _, finding = devices.usb()
    assert finding.level is Level.WARNING
    assert "Zadig" in finding.remedy


def test_old_firmware_and_a_slow_link_are_told_apart(plug: Plug) -> None:
    plug.speed = 3
    _, slow = devices.usb()
    assert "USB 2" in slow.what
    plug.iidc = True
    count, old = devices.usb()
    assert "0 USB3 Vision" in count.what
    assert "IIDC" in old.what
    assert "firmware" in old.remedy


def test_nis_driver_is_told_with_its_version_and_its_cards(monkeypatch: pytest.MonkeyPatch) -> None:
    version = SimpleNamespace(major_version=25, minor_version=3)
    card = SimpleNamespace(name="Dev1", product_type="USB-6211")
    system = SimpleNamespace(driver_version=version, devices=[card])
    monkeypatch.setattr("nidaqmx.system.System.local", staticmethod(lambda: system))
    (finding,) = devices.galvo_card()
    assert (finding.level, finding.what) == (Level.OK, "NI-DAQmx 25.3; cards: Dev1 (USB-6211)")
    system.devices.clear()
    _, finding = devices.galvo_card()
    assert finding.level is Level.WARNING


def test_without_nis_driver_the_rest_still_works(monkeypatch: pytest.MonkeyPatch) -> None:
    from nidaqmx.errors import DaqNotFoundError

    def absent() -> None:
        raise DaqNotFoundError("Could not find an installation of NI-DAQmx. Please ...")

    monkeypatch.setattr("nidaqmx.system.System.local", staticmethod(absent))
    (finding,) = devices.galvo_card()
    assert finding.level is Level.WARNING
    assert "simulated rig" in finding.remedy


def test_the_virtual_card_is_listed_as_nis_would_be() -> None:
    from napari_elsplus.hardware.virtual.card.card import VirtualCard
    from ni_library import replacing_ni_library

    with replacing_ni_library(VirtualCard()):
        (finding,) = devices.galvo_card()
    assert finding.what == "NI-DAQmx 25.0; cards: Dev1 (virtual card)"


def test_rigs_are_listed_and_a_wrong_file_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ELSPLUS_CONFIG", str(tmp_path))
    folder = tmp_path / "rigs"
    folder.mkdir()
    (folder / "good.toml").write_text("[card]\npark_v = -0.7\n")
    (folder / "wrong.toml").write_text("[card]\npark_v = 70\n")
    listed, wrong = devices.rigs()
    assert listed.level is Level.OK
    assert "simulated, good, wrong" in listed.what
    assert wrong.level is Level.WARNING
    assert "park_v" in wrong.what
