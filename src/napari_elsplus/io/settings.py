"""What is remembered between runs: a TOML file in the user's configuration folder.

Each part of the software keeps a section of its own. A file that cannot be read or written costs the memory, not the
work: a warning says so.
"""

from __future__ import annotations

import tomllib
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tomli_w

from napari_elsplus.io import replacing
from napari_elsplus.io.user_folders import config_folder

if TYPE_CHECKING:
    import os


def settings_file() -> Path:
    """Where the settings are kept."""
    return config_folder() / "settings.toml"


def recall(section: str) -> dict[str, Any]:
    """Return what a section remembers; nothing at first.

    Parameters
    ----------
    section : str
        Name of the section.

    Returns
    -------
    dict
        Its keys and values.
    """
    values = _all().get(section, {})
    return values if isinstance(values, dict) else {}


def remember(section: str, **values: Any) -> None:
    """Keep values in a section for the next run; None forgets one.

    Parameters
    ----------
    section : str
        Name of the section.
    **values
        Strings, numbers, booleans, and lists or dicts of them.
    """
    content = _all()
    kept = {**recall(section), **values}
    content[section] = {name: value for name, value in kept.items() if value is not None}
    path = settings_file()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path, force=True) as beside:
            beside.write_text(tomli_w.dumps(content), encoding="utf-8")
    except OSError as error:
        warnings.warn(f"the settings could not be kept in {path}: {error.strerror}", stacklevel=2)


def active_calibration() -> Path | None:
    """Return the calibration file that recordings without one of their own are shown with, if it still exists."""
    path = recall("calibration").get("in_force")
    return Path(path) if isinstance(path, str) and Path(path).is_file() else None


def set_active_calibration(calibration: str | os.PathLike[str] | None) -> None:
    """Make a calibration file the one in force, or none."""
    remember("calibration", in_force=None if calibration is None else str(Path(calibration).resolve()))


def _all() -> dict[str, Any]:
    path = settings_file()
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        return {}
    except (OSError, ValueError) as error:
        warnings.warn(f"the settings in {path} could not be read ({error!s:.80}); the defaults hold", stacklevel=3)
        return {}
