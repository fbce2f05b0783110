"""Folder of the user's own files: settings and rigs."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final

import platformdirs

CONFIG_VARIABLE: Final = "ELSPLUS_CONFIG"
"""Environment variable that names another folder."""


def config_folder() -> Path:
    """Return the folder for settings and rigs; it need not exist."""
    return Path(os.environ.get(CONFIG_VARIABLE) or platformdirs.user_config_dir("napari-elsplus", appauthor=False))
