"""Mosaics and tracks as a viewer shows them, while they grow and when they are finished."""
