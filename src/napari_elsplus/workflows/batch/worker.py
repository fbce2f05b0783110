"""Preloaded by local workers of a batch: what their tasks import, and the setup of their process."""

from __future__ import annotations

import signal
from typing import Any

import napari_elsplus.workflows.batch.stages  # noqa: F401


def dask_setup(_worker: Any) -> None:
    """Ignore Ctrl-C in a worker; dask calls this when one starts. The process that submits tasks ends its workers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
