"""Virtual cameras for the checks."""

from virtual_devices import cameras

__all__ = ["cameras"]
