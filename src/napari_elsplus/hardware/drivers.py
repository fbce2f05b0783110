"""Open cameras and scanners by the kinds that a rig file names: drivers of this package, or classes outside it.

A rig file is the only place from which a driver is imported: recordings and calibrations name none.
"""

from __future__ import annotations

from contextlib import suppress
from functools import partial
from importlib import import_module
from inspect import getattr_static
from typing import TYPE_CHECKING, Any

from napari_elsplus.errors import DeviceError, ElsPlusError, InputError
from napari_elsplus.hardware.daq.scanner import DaqScanner
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
        camera: Camera = _open_outside(table.kind, Camera, **table.options)
        return camera
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
    kind, card, limits = settings.scanner.kind, settings.card_settings(), settings.limits()
    if ":" in kind:
        scanner: Scanner = _open_outside(kind, Scanner, card, limits, **settings.scanner.options)
        return scanner
    return DaqScanner(card, limits)


def features_of(table: CameraTable) -> Callable[[Control], Features]:
    """Return what makes the features of a camera's make on its control channel.

    Parameters
    ----------
    table : CameraTable
        Table ``camera`` of a rig file, of a kind in this package.
    """
    wiring: dict[str, Any] = {"line_rate_hz": table.line_rate_hz, "strobe_line": table.strobe_line}
    if table.kind == "flea3":
        from napari_elsplus.hardware.u3v.flea3 import Flea3

        return partial(Flea3, **wiring)
    from napari_elsplus.hardware.u3v.genapi import GenicamFeatures

    return partial(GenicamFeatures, **wiring)


def _open_outside(kind: str, protocol: type, *arguments: object, **options: Any) -> Any:
    """Import a driver and open its device; whatever a stranger's module raises becomes one line."""
    module, _, name = kind.partition(":")
    try:
        driver = getattr(import_module(module), name)
    except Exception as error:
        raise InputError(
            f"the driver {kind} cannot be imported ({type(error).__name__}: {error})",
            "install its package into this environment, or correct kind in the rig's file",
        ) from error
    try:
        device = driver(*arguments, **options)
    except ElsPlusError:
        raise
    except Exception as error:
        raise DeviceError(
            f"the driver {kind} cannot open its device ({type(error).__name__}: {error})",
            "check its options in the rig's file, and the device",
        ) from error
    lacking = [member for member in _members(protocol) if getattr_static(device, member, None) is None]
    if lacking:
        with suppress(Exception):  # it may lack close as well
            device.close()
        raise InputError(
            f"the driver {kind} lacks {', '.join(lacking)}",
            f"implement napari_elsplus.hardware.protocols.{protocol.__name__}",
        )
    return device


def _members(protocol: type) -> list[str]:
    return [name for name in vars(protocol) if not name.startswith("_") or name in {"__enter__", "__exit__"}]
