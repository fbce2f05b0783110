"""The Mosaic panel."""
