"""Axial response: signals of a scan of depths, drop-off distances, and what restricts them."""
