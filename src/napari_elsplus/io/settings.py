"""Settings that persist between runs: a TOML file in the user's configuration folder.

Each part of the software has a section of its own. A file that cannot be read or written costs the settings and a
warning, not the work; one that cannot be read is kept under another name when the next values are stored.
"""

from __future__ import annotations

import os
import tomllib
import warnings
from itertools import count
from pathlib import Path
from typing import Any, Final

import tomli_w

from napari_elsplus.errors import InputError, error_message
from napari_elsplus.io.atomic import real_path, replacing
from napari_elsplus.io.user_folders import config_folder

_SECTION: Final = "calibration"
_ACTIVE: Final = "active"
_ACTIVE_BEFORE: Final = "in_force"  # the key that earlier versions wrote


def settings_file() -> Path:
    """Return the path of the settings file; it need not exist."""
    return config_folder() / "settings.toml"


def recall(section: str) -> dict[str, Any]:
    """Return the keys and values of a section; empty if nothing was stored, or the file cannot be read."""
    try:
        return _section(_read(), section)
    except (OSError, ValueError) as error:
        warnings.warn(f"{_unreadable(error)}; the defaults hold", stacklevel=2)
        return {}


def remember(section: str, **values: Any) -> None:
    """Store values in a section for the next run; None removes one.

    A file that cannot be read is kept beside the new one under another name.

    Parameters
    ----------
    section : str
        Name of the section.
    **values
        Strings, numbers, booleans, and lists or dicts of them.
    """
    path = settings_file()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        content = _read_or_set_aside()
        before = _section(content, section)
        after = {name: value for name, value in {**before, **values}.items() if value is not None}
        if after == before:  # writing waits for a disk that may be busy with a recording
            return
        content[section] = after
        with replacing(path, force=True) as beside:
            beside.write_text(tomli_w.dumps(content), encoding="utf-8")
    except (OSError, InputError) as error:
        warnings.warn(f"the settings could not be kept: {error_message(error)}", stacklevel=2)


def active_calibration() -> Path | None:
    """Return the file of the active calibration, which applies to recordings without one of their own, if it exists."""
    known = recall(_SECTION)
    path = known.get(_ACTIVE, known.get(_ACTIVE_BEFORE))
    return Path(path) if isinstance(path, str) and Path(path).is_file() else None


def set_active_calibration(calibration: str | os.PathLike[str] | None) -> None:
    """Make a `calibration` file the active one; None leaves no active calibration."""
    path = None if calibration is None else str(real_path(calibration))
    remember(_SECTION, **{_ACTIVE: path, _ACTIVE_BEFORE: None})


def _read() -> dict[str, Any]:
    try:
        return tomllib.loads(settings_file().read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        return {}


def _read_or_set_aside() -> dict[str, Any]:
    """Return the settings; rename a file that cannot be read, and return none of them."""
    try:
        return _read()
    except (OSError, ValueError) as error:
        path = settings_file()
        others = (path.with_name(f"settings.broken-{number}.toml") for number in count(1))
        aside = next(other for other in others if not os.path.lexists(other))
        path.rename(aside)
        warnings.warn(f"{_unreadable(error)}; they are kept as {aside.name}, mend them there", stacklevel=3)
        return {}


def _section(content: dict[str, Any], name: str) -> dict[str, Any]:
    values = content.get(name, {})
    return values if isinstance(values, dict) else {}


def _unreadable(error: OSError | ValueError) -> str:
    return f"the settings in {settings_file()} could not be read ({error!s:.80})"
