"""Base classes of docked panels, plots, background work, and the shared connection to the engine.

The names exported here, and those of :mod:`napari_elsplus.widgets.shared.plots`, are meant for panels of other
packages: see ``docs/extending-dock-widget.md``.
"""

from napari_elsplus._problems import notify_errors
from napari_elsplus.widgets.shared.connection import Connection
from napari_elsplus.widgets.shared.engine_panel import EnginePanel
from napari_elsplus.widgets.shared.panel import Panel, button_row, copy_as_script, form_layout, set_enabled
from napari_elsplus.widgets.shared.requests import PendingRequests

__all__ = [
    "Connection",
    "EnginePanel",
    "Panel",
    "PendingRequests",
    "button_row",
    "copy_as_script",
    "form_layout",
    "notify_errors",
    "set_enabled",
]
