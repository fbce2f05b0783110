"""Pose graph, live and at the end of a track; positions and displacements are complex: row + i col, pixels."""
