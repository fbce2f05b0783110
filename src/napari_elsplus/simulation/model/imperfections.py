"""Departures of an instrument from the ideal one, as named numbers: galvo, laser line, views, camera, specimen.

Each is one parameter with a unit, a range, and a plausible range from which instruments are drawn at random. The
simulator's image formation follows from them alone; no calibration is involved.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from math import exp, isfinite, log
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Self

import numpy as np

from napari_elsplus.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Mapping


class Parameter(NamedTuple):
    """One imperfection: unit, limits, the range of plausible instruments, what it does.

    A plausible range whose ends have the same sign is drawn from logarithmically, others linearly.
    """

    unit: str
    low: float
    high: float
    plausible: tuple[float, float]
    effect: str


def _imperfection(
    unit: str, low: float, high: float, plausible: tuple[float, float], effect: str, default: float | None = 0.0
) -> Any:
    return field(default=default, metadata={"parameter": Parameter(unit, low, high, plausible, effect)})


@dataclass(frozen=True, slots=True)
class Imperfections:
    """Departures of an instrument from the ideal one; all zero, or absent, by default.

    On the command line and in rig files each is named without its unit: ``galvo-resonance``. `PARAMETERS` describes
    them all.

    Raises
    ------
    InputError
        If a number is out of range.

    Examples
    --------
    >>> Imperfections.parse("galvo-resonance=800,row-noise=0.5").changed
    {'galvo-resonance': 800.0, 'row-noise': 0.5}
    >>> Imperfections.parse("galvo=800")
    Traceback (most recent call last):
        ...
    napari_elsplus.errors.InputError: no imperfection is called 'galvo': ...
    """

    galvo_resonance_hz: float | None = _imperfection(
        "Hz", 200, 10_000, (500, 2000), "resonance of the galvo, where it differs from the rig file's", None
    )
    galvo_damping: float | None = _imperfection(
        "", 0.05, 3, (0.3, 1.0), "damping ratio of the galvo, where it differs from the rig file's", None
    )
    galvo_delay_us: float = _imperfection("us", 0, 1000, (0, 100), "delay of card, amplifier and trigger")
    galvo_s_curve_rows: float = _imperfection(
        "rows", -20, 20, (-2, 2), "largest deviation of the line from a linear galvo map over the bundle, cubic"
    )
    line_bow_rows: float = _imperfection(
        "rows", -20, 20, (-3, 3), "rows by which the line's ends at the bundle's rim lie below its middle"
    )
    line_jitter_rows: float = _imperfection(
        "rows", 0, 10, (0, 0.5), "standard deviation of the line's row from frame to frame"
    )
    line_fall_off_percent: float = _imperfection(
        "%", 0, 80, (0, 30), "power that the line lacks at the bundle's rim relative to its middle"
    )
    line_slant_percent: float = _imperfection(
        "%", -80, 80, (-10, 10), "power that the line has in excess at its right end, and lacks at its left end"
    )
    power_noise_percent: float = _imperfection(
        "%", 0, 50, (0, 3), "standard deviation of the laser's power from row to row, averaged over the exposure"
    )
    power_ripple_percent: float = _imperfection("%", 0, 50, (0, 5), "amplitude of a ripple of the laser's power")
    ripple_frequency_hz: float = _imperfection("Hz", 0.01, 20_000, (100, 5000), "frequency of that ripple", 2300.0)
    left_distortion_percent: float = _imperfection(
        "%", -5, 5, (-0.5, 0.5), "radial distortion of the left view, at its rim; positive: outwards"
    )
    right_distortion_percent: float = _imperfection(
        "%", -5, 5, (-0.5, 0.5), "radial distortion of the right view, at its rim; positive: outwards"
    )
    lens_distortion_percent: float = _imperfection(
        "%", -5, 5, (-0.5, 0.5), "radial distortion about the sensor's centre, half its width away; positive: outwards"
    )
    right_core_gain_percent: float = _imperfection(
        "%", 0, 30, (0, 10), "standard deviation of the right view's gain from core to core"
    )
    right_vignette_percent: float = _imperfection(
        "%", -50, 50, (-10, 10), "gain of the right view in excess in its middle, and lacking at its rim"
    )
    lamp_gain_percent: float = _imperfection(
        "%", -20, 20, (-3, 3), "gain of the right view for a lamp in excess of that for fluorescence: spectrum"
    )
    row_noise_dn: float = _imperfection(
        "grey levels", 0, 20, (0, 2), "standard deviation of the black level from row to row and frame to frame"
    )
    prnu_percent: float = _imperfection("%", 0, 20, (0, 1.5), "standard deviation of the gain from pixel to pixel")
    hot_pixels_percent: float = _imperfection(
        "%", 0, 5, (0, 0.1), "share of pixels with a dark signal of 20 to 200 grey levels"
    )
    halo_in_collection_percent: float = _imperfection(
        "%", 0, 100, (0, 50), "share of the bundle's cross-talk that arises on the way back to the camera"
    )
    bundle_bending_percent: float = _imperfection(
        "%", 0, 30, (0, 5), "change of the cores' transmission where the probe has moved by much more than 0.5 mm"
    )
    bleaching_percent: float = _imperfection(
        "%", 0, 90, (0, 10), "share of the specimen's fluorescence lost in 100 frames"
    )
    ghost_percent: float = _imperfection(
        "%", 0, 50, (0, 0.5), "light of each view that a reflection displays again a sixteenth of the frame beside"
    )

    def __post_init__(self) -> None:
        for name, parameter in PARAMETERS.items():
            value = getattr(self, _FIELDS[name])
            if value is None:
                continue
            if not (isfinite(value) and parameter.low <= value <= parameter.high):
                limits = f"{parameter.low:g} to {parameter.high:g} {parameter.unit}".rstrip()
                raise InputError(f"{name} is {value:g}, outside of {limits}", _names())

    @classmethod
    def of(cls, values: Mapping[str, float]) -> Self:
        """Return imperfections from values by name, as rig files and the command line name them.

        Raises
        ------
        InputError
            If there is no such name, or a value is no number or out of range.
        """
        for name, value in values.items():
            if name not in PARAMETERS:
                raise InputError(f"no imperfection is called {name!r:.40}", _names())
            if isinstance(value, bool) or not isinstance(value, (int, float)):
                raise InputError(f"{name} is {value!r:.40}, which is no number", _names())
        return cls(**{_FIELDS[name]: float(value) for name, value in values.items()})

    @classmethod
    def parse(cls, text: str) -> Self:
        """Return imperfections from text ``name=value,name=value``.

        Raises
        ------
        InputError
            If the text has another form, or as of `of`.
        """
        values: dict[str, float] = {}
        for part in filter(None, (part.strip() for part in text.split(","))):
            name, _, number = part.partition("=")
            try:
                values[name.strip()] = float(number)
            except ValueError:
                raise InputError(f"{part!r:.60} is no imperfection", f"give NAME=VALUE; {_names()}") from None
        return cls.of(values)

    @classmethod
    def drawn(cls, seed: int) -> Self:
        """Return the imperfections of an instrument drawn at random: each from its plausible range, independently.

        Parameters
        ----------
        seed : int
            0 or more; the same seed gives the same instrument.

        Examples
        --------
        >>> Imperfections.drawn(3) == Imperfections.drawn(3) != Imperfections.drawn(4)
        True
        """
        rng = np.random.default_rng((_DRAW, seed))
        return cls(**{_FIELDS[name]: _draw(parameter.plausible, rng) for name, parameter in PARAMETERS.items()})

    @classmethod
    def require(cls, imperfections: object) -> None:
        """Refuse `imperfections` as text or as a table, which have to be read first, and anything else.

        Raises
        ------
        InputError
            If they are no record of this class.
        """
        if not isinstance(imperfections, cls):
            reader = "parse" if isinstance(imperfections, str) else "of"
            given = f"{imperfections!r:.60}"
            raise InputError(f"imperfections are given as {given}", f"give `Imperfections.{reader}({given})`")

    @property
    def changed(self) -> dict[str, float]:
        """Values that differ from the ideal instrument's, by name."""
        mine = ((name, getattr(self, _FIELDS[name])) for name in PARAMETERS)
        return {name: value for name, value in mine if value != _DEFAULTS[name]}

    @property
    def of_left_geometry(self) -> Imperfections:
        """Those alone that determine where the left view shows a core."""
        return self._only("left_distortion_percent", "lens_distortion_percent")

    @property
    def of_views(self) -> Imperfections:
        """Those alone that determine where, and with which gain, the views show the cores."""
        gains = "right_core_gain_percent", "right_vignette_percent", "lamp_gain_percent"
        return self._only("left_distortion_percent", "right_distortion_percent", "lens_distortion_percent", *gains)

    def _only(self, *names: str) -> Imperfections:
        return Imperfections(**{name: getattr(self, name) for name in names})

    @property
    def distorts(self) -> bool:
        """True if a view is distorted."""
        return any(name.endswith("-distortion") for name in self.changed)

    @property
    def moves_galvo(self) -> bool:
        """True if the galvo's motion differs from the rig file's."""
        return any(name.startswith("galvo-") for name in self.changed)


_DRAW: Final = 0xE15
"""Keeps the draws apart from other uses of the same seed; chosen."""
_FIELDS: Final[dict[str, str]] = {}
_DEFAULTS: Final[dict[str, Any]] = {}
PARAMETERS: Final[dict[str, Parameter]] = {}
"""Imperfections by the names that rig files and the command line use."""

for _field in fields(Imperfections):
    _parameter: Parameter = _field.metadata["parameter"]
    _unit_at = _field.name.rfind("_") if _parameter.unit else len(_field.name)
    _name = _field.name[:_unit_at].replace("_", "-")
    _FIELDS[_name], _DEFAULTS[_name], PARAMETERS[_name] = _field.name, _field.default, _parameter


def _names() -> str:
    return f"the imperfections are {', '.join(PARAMETERS)}"


def _draw(plausible: tuple[float, float], rng: np.random.Generator) -> float:
    low, high = plausible
    return exp(rng.uniform(log(low), log(high))) if low > 0 else float(rng.uniform(low, high))


IDEAL: Final = Imperfections()
"""The ideal instrument."""
