"""Import and open drivers of devices from outside this package."""

from __future__ import annotations

from contextlib import suppress
from importlib import import_module
from inspect import getattr_static
from typing import Any

from napari_elsplus.errors import DeviceError, ElsPlusError, InputError


def import_driver(kind: str) -> Any:
    """Import the class of a driver outside this package.

    Parameters
    ----------
    kind : str
        ``"package.module:Class"``.

    Raises
    ------
    InputError
        If it cannot be imported.
    """
    module, _, name = kind.partition(":")
    try:
        return getattr(import_module(module), name)
    except Exception as error:
        raise InputError(
            f"the driver {kind} cannot be imported ({type(error).__name__}: {error})",
            "install its package into this environment, or correct kind in the rig's file",
        ) from error


def open_outside(kind: str, protocol: type, *arguments: object, **options: Any) -> Any:
    """Import a driver outside this package and open its device; whatever it raises becomes one line.

    Parameters
    ----------
    kind : str
        ``"package.module:Class"``.
    protocol : type
        `Camera` or `Scanner`.
    *arguments, **options
        Of the class.

    Raises
    ------
    InputError
        If it cannot be imported, or lacks a part of the protocol.
    DeviceError
        If its device does not open.
    """
    driver = import_driver(kind)
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
