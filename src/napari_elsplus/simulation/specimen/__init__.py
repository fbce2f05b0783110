"""Specimens, and the motion of the probe over them."""
