"""Processes that a Ctrl-C or a closed terminal of this one does not reach."""

from __future__ import annotations

import subprocess
import sys
from typing import Any, Final

if sys.platform == "win32":
    DETACHED: Final[dict[str, Any]] = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
else:
    DETACHED: Final[dict[str, Any]] = {"start_new_session": True}
"""Arguments of `subprocess.Popen` for such a process; on Windows ``start_new_session`` would be ignored."""
