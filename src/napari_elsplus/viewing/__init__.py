"""Recordings as a viewer wants them: lazy arrays, and layers with scale, units and names; no viewer in here."""
