"""Settings that persist between runs: a TOML file in the user's configuration folder.

Each part of the software has a section of its own. A file that cannot be read or written costs the settings and a
warning, not the work.
"""

from __future__ import annotations

import tomllib
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import tomli_w

from napari_elsplus.io.atomic import replacing
from napari_elsplus.io.user_folders import config_folder

if TYPE_CHECKING:
    import os

_SECTION: Final = "calibration"
_ACTIVE: Final = "active"
_ACTIVE_BEFORE: Final = "in_force"  # the key that earlier versions wrote


def settings_file() -> Path:
    """Return the path of the settings file; it need not exist."""
    return config_folder() / "settings.toml"


def recall(section: str) -> dict[str, Any]:
    """Return the keys and values of a section; empty if nothing was stored."""
    values = _all().get(section, {})
    return values if isinstance(values, dict) else {}


def remember(section: str, **values: Any) -> None:
    """Store values in a section for the next run; None removes one.

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
    """Return the file of the active calibration, which applies to recordings without one of their own, if it exists."""
    known = recall(_SECTION)
    path = known.get(_ACTIVE, known.get(_ACTIVE_BEFORE))
    return Path(path) if isinstance(path, str) and Path(path).is_file() else None


def set_active_calibration(calibration: str | os.PathLike[str] | None) -> None:
    """Make a `calibration` file the active one; None leaves no active calibration."""
    path = None if calibration is None else str(Path(calibration).resolve())
    remember(_SECTION, **{_ACTIVE: path, _ACTIVE_BEFORE: None})


def _all() -> dict[str, Any]:
    path = settings_file()
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        return {}
    except (OSError, ValueError) as error:
        warnings.warn(f"the settings in {path} could not be read ({error!s:.80}); the defaults hold", stacklevel=3)
        return {}
