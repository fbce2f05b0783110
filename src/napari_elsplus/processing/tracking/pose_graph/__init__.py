"""Keyframes, loop closure, and the pose graph, live and after the end."""
