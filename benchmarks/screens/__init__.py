"""Pictures of every panel in napari, and a measurement of text that does not fit its place."""
