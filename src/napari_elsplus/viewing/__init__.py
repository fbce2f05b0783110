"""Lazy arrays and layer data of recordings and mosaics, independent of Qt and napari."""
