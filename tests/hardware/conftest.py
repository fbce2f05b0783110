"""Virtual devices for the real drivers."""

from virtual_devices import calibration, cameras, cards, wait_for

__all__ = ["calibration", "cameras", "cards", "wait_for"]
