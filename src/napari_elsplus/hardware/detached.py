"""Processes that a Ctrl-C or a closed terminal of this one does not reach."""

from __future__ import annotations

import subprocess
import sys
from typing import Any, Final

if sys.platform == "win32":
    DETACHED: Final[dict[str, Any]] = {
        "creationflags": subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.CREATE_NO_WINDOW
    }
else:
    DETACHED: Final[dict[str, Any]] = {"start_new_session": True}
"""Arguments of `subprocess.Popen` for such a process.

On Windows ``start_new_session`` would be ignored; Ctrl-C is sent to a process group, and the end of a console to every
process on it, so that such a process has a group and a console of its own.
"""
