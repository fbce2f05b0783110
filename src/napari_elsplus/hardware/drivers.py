"""Open cameras and scanners by the kinds that a rig file names: drivers of this package, or classes outside it.

A rig file is the only place from which a driver is imported: recordings and calibrations name none.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

from napari_elsplus.hardware.daq.scanner import DaqScanner
from napari_elsplus.hardware.micro_manager.camera import MicroManagerCamera
from napari_elsplus.hardware.outside import open_outside
from napari_elsplus.hardware.protocols import Camera, Scanner

if TYPE_CHECKING:
    from collections.abc import Callable

    from napari_elsplus.hardware.rig_files import CameraTable, RigSettings
    from napari_elsplus.hardware.u3v.camera import Features
    from napari_elsplus.hardware.u3v.control import Control


def open_camera(table: CameraTable) -> Camera:
    """Open the camera of a rig.

    Parameters
    ----------
    table : CameraTable
        Table ``camera`` of the rig file; a class outside this package is called with its ``options``.

    Raises
    ------
    InputError
        If the driver cannot be imported or lacks a part of the protocol.
    DeviceError
        If the camera is absent, busy or fails.
    """
    if ":" in table.kind:
        camera: Camera = open_outside(table.kind, Camera, **table.options)
        return camera
    if table.micro_manager is not None:
        return MicroManagerCamera(**table.micro_manager.model_dump(), line_rate_hz=table.line_rate_hz)
    from napari_elsplus.hardware.u3v.camera import U3vCamera
    from napari_elsplus.hardware.u3v.discovery import choose_camera

    return U3vCamera(choose_camera(table.serial), features_of(table))


def open_scanner(settings: RigSettings) -> Scanner:
    """Open the scanner of a rig.

    Parameters
    ----------
    settings : RigSettings
        The rig file; a class outside this package is called with the card's settings, the galvo's limits, and
        the ``options`` of the table ``scanner``.

    Raises
    ------
    InputError
        If the driver cannot be imported or lacks a part of the protocol.
    DeviceError
        If the card is absent, busy or fails.
    """
    kind, card, limits = settings.scanner.kind, settings.card, settings.mirror
    if ":" in kind:
        scanner: Scanner = open_outside(kind, Scanner, card, limits, **settings.scanner.options)
        return scanner
    return DaqScanner(card, limits)


def features_of(table: CameraTable) -> Callable[[Control], Features]:
    """Return what makes the features of a camera's make on its control channel.

    Parameters
    ----------
    table : CameraTable
        Table ``camera`` of a rig file, of a USB3 Vision camera.
    """
    wiring: dict[str, Any] = {"line_rate_hz": table.line_rate_hz, "strobe_line": table.strobe_line}
    if table.kind == "flea3":
        from napari_elsplus.hardware.u3v.flea3 import Flea3

        return partial(Flea3, **wiring)
    from napari_elsplus.hardware.u3v.genapi import GenicamFeatures

    return partial(GenicamFeatures, **wiring)
