"""From tracked frames to a mosaic: tiles, insertion, pyramid, coverage."""
