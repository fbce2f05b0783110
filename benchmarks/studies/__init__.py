"""Measurements of accuracy that several pages of the documentation rest on."""
