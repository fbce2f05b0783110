"""The rig and the camera settings that the user chose last, in whichever panel, and the names of the presets."""

from __future__ import annotations

from dataclasses import asdict
from typing import Final

from napari_elsplus.acquisition.engine.status import Settings
from napari_elsplus.hardware.rig import SIMULATED
from napari_elsplus.hardware.rigs import rig_names
from napari_elsplus.instrument.optics import PRESETS, preset
from napari_elsplus.io.settings import recall, remember

_SECTION: Final = "rig"


def remembered_rig() -> str:
    """Return the name of the rig used last; the simulated rig at first."""
    name = recall(_SECTION).get("name", SIMULATED)
    return name if name in rig_names() else SIMULATED


def remembered_settings() -> Settings:
    """Return the settings used last; the defaults where these are none, as of another version."""
    last = recall(_SECTION)
    chosen, rate_hz = last.get("preset"), last.get("frame_rate_hz")
    try:
        return Settings(
            chosen if chosen in PRESETS else "240hz",
            int(last.get("slit_rows", 3)),
            None if rate_hz is None else float(rate_hz),
            float(last.get("gain_db", 0.0)),
        )
    except (TypeError, ValueError):
        return Settings()


def remember_rig(rig: str, settings: Settings) -> None:
    """Propose a `rig` and its `settings` the next time."""
    remember(_SECTION, name=rig, **asdict(settings))


def preset_label(name: str) -> str:
    """Return the display name of a preset: rate, magnification, objective."""
    magnification = {"120hz": "high", "240hz": "low"}.get(name)
    rate = name.replace("hz", " Hz")
    return rate if magnification is None else f"{rate}, {magnification} magnification ({preset(name).objective})"
