"""Frames on their way: rings, shared memory, the recorder, and what is counted."""
