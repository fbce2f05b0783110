"""Rigs of the user: one TOML file each, in the user's configuration folder."""

from __future__ import annotations

import re
import tomllib
from typing import TYPE_CHECKING, Annotated, Any, Final

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from napari_elsplus.errors import InputError
from napari_elsplus.hardware.daq.output import CardSettings
from napari_elsplus.hardware.micro_manager.frame_count import CORE_NUMBER
from napari_elsplus.hardware.rig import SIMULATED, SIMULATED_REAL
from napari_elsplus.hardware.scan.timing import StrobePhase
from napari_elsplus.hardware.scan.waveform import GalvoLimits
from napari_elsplus.instrument.optics import LINE_RATE_HZ
from napari_elsplus.io.user_folders import config_folder
from napari_elsplus.simulation.model.bundle import Bundle
from napari_elsplus.simulation.model.imperfections import Imperfections

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path
    from typing import Self

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
RESERVED = (SIMULATED, SIMULATED_REAL)
"""Names that no file may take."""


U3V_KINDS: Final = ("flea3", "genicam")
"""Drivers of USB3 Vision cameras."""
MICRO_MANAGER: Final = "mmcore"
"""Driver of Micro-Manager's cameras."""
CAMERA_KINDS: Final = (*U3V_KINDS, MICRO_MANAGER)
SCANNER_KINDS: Final = ("nidaqmx",)
"""Drivers of this package."""
DRIVER: Final = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*")
"""``package.module:Class``: a driver outside this package."""


def _kind_among(built_in: tuple[str, ...]) -> Callable[[str], str]:
    def check(kind: str) -> str:
        if kind not in built_in and not DRIVER.fullmatch(kind):
            raise ValueError(f"choose {', '.join(built_in)}, or a driver as package.module:Class")
        return kind

    return check


class _Table(BaseModel):
    """A table of the file; an unknown key is an error, since it is a misspelling."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class _DriverTable(_Table):
    """A device: a driver of this package by its name, or ``package.module:Class`` with that class's own options."""

    kind: str
    options: dict[str, Any] = {}

    @model_validator(mode="after")
    def _options_belong_to_a_class(self) -> Self:
        if self.options and ":" not in self.kind:
            raise ValueError(f"options are for a driver as package.module:Class; {self.kind} takes none")
        return self


class MicroManagerTable(_Table):
    """A camera of Micro-Manager: its configuration file, and the names of its properties and tags."""

    config: str
    frame_rate: str
    gain: str = ""
    frame_number: str = CORE_NUMBER
    folder: str = ""


class CameraTable(_DriverTable):
    """Camera driver, and what the camera does not report by itself."""

    kind: Annotated[str, AfterValidator(_kind_among(CAMERA_KINDS))] = "flea3"
    serial: str = ""
    line_rate_hz: Positive = LINE_RATE_HZ
    strobe: StrobePhase = StrobePhase.EXPOSURE
    strobe_line: Annotated[int, Field(ge=0, le=3)] = 1
    micro_manager: MicroManagerTable | None = None

    @model_validator(mode="after")
    def _micro_manager_has_its_table(self) -> Self:
        if (self.kind == MICRO_MANAGER) != (self.micro_manager is not None):
            raise ValueError(f'kind = "{MICRO_MANAGER}" and the table camera.micro_manager need each other')
        return self


class ScannerTable(_DriverTable):
    """Scanner driver."""

    kind: Annotated[str, AfterValidator(_kind_among(SCANNER_KINDS))] = "nidaqmx"


class SimulationTable(_Table):
    """A simulated instrument in the place of devices."""

    imperfections: dict[str, float] = {}
    bundle_seed: Annotated[int, Field(ge=0)] = Bundle().seed

    @field_validator("imperfections")
    @classmethod
    def _imperfections_exist(cls, values: dict[str, float]) -> dict[str, float]:
        try:
            Imperfections.of(values)
        except InputError as error:
            raise ValueError(str(error)) from None
        return values


class _Settings(_Table):
    """Content of a rig file: its tables."""

    mirror: GalvoLimits = GalvoLimits()

    @classmethod
    def parse(cls, content: dict[str, Any], name: str) -> Self:
        """Validate the content of a rig file.

        Parameters
        ----------
        content : dict
            Tables by their names.
        name : str
            Name of the rig, for messages.

        Raises
        ------
        InputError
            Naming the key that is wrong, and its value.
        """
        try:
            settings = cls.model_validate(content)
        except InputError as error:
            raise InputError(f"rig {name}: {error.problem}", f"{error.remedy}, in the rig's file") from None
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(str(part) for part in first["loc"])
            value = "" if isinstance(first["input"], (dict, BaseModel)) else f" (value {first['input']!r:.60})"
            problem = ": ".join(filter(None, (f"rig {name}", where, first["msg"].removeprefix("Value error, "))))
            raise InputError(f"{problem}{value}", "correct it in the rig's file") from None
        return settings


class SimulatedRigSettings(_Settings):
    """Content of the file of a simulated rig: table ``simulation`` in the place of the devices.

    Examples
    --------
    >>> content = {"simulation": {"imperfections": {"galvo-resonance": 800}}, "mirror": {"natural_hz": 1000}}
    >>> SimulatedRigSettings.parse(content, "rough").imperfections.changed
    {'galvo-resonance': 800.0}
    """

    simulation: SimulationTable

    @property
    def imperfections(self) -> Imperfections:
        """Departures of the simulated instrument from the ideal one."""
        return Imperfections.of(self.simulation.imperfections)


class RigSettings(_Settings):
    """Content of the file of a rig of devices.

    Examples
    --------
    >>> RigSettings.parse({"card": {"park_v": -0.7}}, "mine").card.park_v
    -0.7
    """

    card: CardSettings
    camera: CameraTable = CameraTable()
    scanner: ScannerTable = ScannerTable()

    @model_validator(mode="after")
    def _parking_is_within_the_range(self) -> Self:
        low, park_v, high = self.mirror.min_v, self.card.park_v, self.mirror.max_v
        if not low <= park_v <= high:
            raise ValueError(f"the parking position park_v {park_v:g} is outside min_v {low:g} to max_v {high:g}")
        return self


def rig_folder() -> Path:
    """Return the folder of the rig files."""
    return config_folder() / "rigs"


def rig_files() -> dict[str, Path]:
    """Return the rig files by the names of their rigs."""
    return {path.stem: path for path in rig_folder().glob("*.toml") if path.stem not in RESERVED}


def read_rig(name: str) -> RigSettings | SimulatedRigSettings:
    """Read the file of the rig of that name.

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
    return (SimulatedRigSettings if "simulation" in content else RigSettings).parse(content, name)


def rig_settings(name: str) -> RigSettings | SimulatedRigSettings:
    """Return the settings of a rig by its name.

    ``simulated`` is the ideal instrument. ``simulated-real`` and ``simulated-real:SEED`` are drawn at random from
    plausible imperfections, and state nothing about their galvo. Others have files.

    Raises
    ------
    InputError
        If there is no such rig, its file is wrong, or the seed is no whole number.
    """
    if name == SIMULATED:
        return SimulatedRigSettings(simulation=SimulationTable())
    base, colon, seed = name.partition(":")
    if base != SIMULATED_REAL:
        return read_rig(name)
    if colon and not (seed.isascii() and seed.isdigit()):
        raise InputError(f"{seed!r:.40} is no seed of the rig {SIMULATED_REAL}", "give a whole number, 0 or more")
    number = int(seed or 0)
    drawn = SimulationTable(imperfections=Imperfections.drawn(number).changed, bundle_seed=number)
    return SimulatedRigSettings(simulation=drawn)


def is_simulated(name: str | None) -> bool:
    """Return True for the name of a simulated rig, which changes its targets unattended; False if there is no such rig.

    Examples
    --------
    >>> is_simulated("simulated"), is_simulated("simulated-real:7"), is_simulated(None)
    (True, True, False)
    """
    try:
        return name is not None and isinstance(rig_settings(name), SimulatedRigSettings)
    except InputError:
        return False
