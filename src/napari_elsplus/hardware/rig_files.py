"""A user's own rigs: one readable TOML file each, in the user's configuration folder."""

from __future__ import annotations

import tomllib
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from napari_elsplus.errors import InputError
from napari_elsplus.hardware.daq.output import CardSettings
from napari_elsplus.hardware.scan.timing import StrobePhase
from napari_elsplus.hardware.scan.waveform import GalvoLimits
from napari_elsplus.hardware.u3v.flea3 import Flea3
from napari_elsplus.instrument.optics import LINE_RATE_HZ
from napari_elsplus.io.user_folders import config_folder

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from napari_elsplus.hardware.u3v.camera import Features
    from napari_elsplus.hardware.u3v.control import Control

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Volts = Annotated[float, Field(ge=-10, le=10, allow_inf_nan=False)]
RESERVED = ("simulated",)


class _Table(BaseModel):
    """A part of the file; a key that is not known is an error, since it is a misspelling."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class CameraTable(_Table):
    """Which camera, and what it does not tell by itself."""

    kind: Literal["flea3", "genicam"] = "flea3"
    serial: str = ""
    line_rate_hz: Positive = LINE_RATE_HZ
    strobe: StrobePhase = StrobePhase.EXPOSURE
    strobe_line: Annotated[int, Field(ge=0, le=3)] = 1

    def features(self) -> Callable[[Control], Features]:
        """Return what makes the features of this kind of camera."""
        if self.kind == "flea3":
            return partial(Flea3, line_rate_hz=self.line_rate_hz, strobe_line=self.strobe_line)
        from napari_elsplus.hardware.u3v.genapi import GenicamFeatures

        return partial(GenicamFeatures, line_rate_hz=self.line_rate_hz, strobe_line=self.strobe_line)


class CardTable(_Table):
    """Which card, and what is wired to it; the parking voltage has to be measured or confirmed."""

    park_v: Volts
    device: str = "Dev1"
    output: str = "ao0"
    counter: str = "ctr0"
    strobe: str = "PFI0"
    falling: bool = True
    hold_limit_s: Annotated[float, Field(gt=0, le=600)] = 20.0
    address: str = ""


class GalvoTable(_Table):
    """What mirror and card may be asked for."""

    min_v: Volts = -2.0
    max_v: Volts = 2.0
    max_slew_v_per_s: Positive = 1.0e4
    max_acceleration_v_per_s2: Positive = 5.0e7
    card_samples: Annotated[int, Field(gt=0)] = 8191
    natural_hz: Positive | None = None
    damping: Positive = 0.7


class RigSettings(_Table):
    """Everything in a rig's file.

    Examples
    --------
    >>> RigSettings.parse({"card": {"park_v": -0.7}}, "mine").card_settings().park_v
    -0.7
    """

    card: CardTable
    camera: CameraTable = CameraTable()
    mirror: GalvoTable = GalvoTable()

    @classmethod
    def parse(cls, content: dict[str, Any], name: str) -> RigSettings:
        """Validate a file's content.

        Raises
        ------
        InputError
            Naming the key that is wrong, and its value.
        """
        try:
            settings = cls.model_validate(content)
            settings.limits().check(settings.card.park_v, "the parking position")
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(str(part) for part in first["loc"])
            value = "" if isinstance(first["input"], dict) else f" (value {first['input']!r:.60})"
            raise InputError(f"rig {name}: {where}: {first['msg']}{value}", "correct it in the rig's file") from None
        return settings

    def card_settings(self) -> CardSettings:
        """Return the card's part for its driver."""
        return CardSettings(**self.card.model_dump())

    def limits(self) -> GalvoLimits:
        """Return the mirror's limits."""
        return GalvoLimits(**self.mirror.model_dump())


def rig_folder() -> Path:
    """Where the files are."""
    return config_folder() / "rigs"


def rig_files() -> dict[str, Path]:
    """Return the files by the names of their rigs."""
    return {path.stem: path for path in rig_folder().glob("*.toml") if path.stem not in RESERVED}


def read_rig(name: str) -> RigSettings:
    """Read a rig's file.

    Raises
    ------
    InputError
        If there is none, or it is wrong.
    """
    files = rig_files()
    if name not in files:
        known = ", ".join([*RESERVED, *sorted(files)])
        raise InputError(f"there is no rig {name!r}", f"choose one of {known}, or write {rig_folder() / 'NAME.toml'}")
    try:
        content = tomllib.loads(files[name].read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"rig {name}: {error}", f"correct {files[name]}") from error
    return RigSettings.parse(content, name)
