"""napari with the plugin in it: ``python -m napari_elsplus._window``.

Docks what the manifest declares as widgets; while it declares none, opens the first of the sample data.
"""

from __future__ import annotations

import signal

import napari
from npe2 import PluginManager

PLUGIN = "napari-elsplus"


def fill(viewer: napari.Viewer) -> None:
    """Put what the plugin offers into a viewer."""
    offers = PluginManager.instance().get_manifest(PLUGIN).contributions
    for widget in offers.widgets or ():
        viewer.window.add_plugin_dock_widget(PLUGIN, widget.display_name, tabify=True)
    if not offers.widgets and offers.sample_data:
        viewer.open_sample(PLUGIN, offers.sample_data[0].key)
        viewer.canvas.overlays.scale_bar.visible = True
        viewer.reset_view()


def main() -> None:
    """Open the window and stay until it is closed; a termination closes it as a click would."""
    viewer = napari.Viewer()
    fill(viewer)
    signal.signal(signal.SIGTERM, lambda *_: viewer.close())
    napari.run()


if __name__ == "__main__":
    main()
