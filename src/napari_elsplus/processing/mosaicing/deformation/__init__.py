"""Deformation of tissue between frames, and the shape of the tissue at rest."""
