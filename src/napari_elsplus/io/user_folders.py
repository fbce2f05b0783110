"""Folders of the user: settings and rigs; what is remembered to start quickly."""

from __future__ import annotations

import hashlib
import os
from functools import cache
from pathlib import Path
from typing import Final

import platformdirs

CONFIG_VARIABLE: Final = "ELSPLUS_CONFIG"
"""Environment variable that names another folder for settings and rigs."""
CACHE_VARIABLE: Final = "ELSPLUS_CACHE"
"""Environment variable that names another folder for what can be made again."""


def config_folder() -> Path:
    """Return the folder for settings and rigs; it need not exist."""
    return Path(os.environ.get(CONFIG_VARIABLE) or platformdirs.user_config_dir("napari-elsplus", appauthor=False))


def cache_folder() -> Path:
    """Return the folder for what can be made again, such as calibrations of simulated rigs; it need not exist."""
    return Path(os.environ.get(CACHE_VARIABLE) or platformdirs.user_cache_dir("napari-elsplus", appauthor=False))


@cache
def software_fingerprint() -> str:
    """Return a hash of the package's sources: what one version has remembered, another does not recall."""
    files = sorted(Path(__file__).parents[1].rglob("*.py"))
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()
