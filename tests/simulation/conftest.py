"""Lets this folder's tests import their helper by name; pytest's import mode does not."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
