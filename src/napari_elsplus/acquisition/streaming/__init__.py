"""Streams of frames: rings, shared memory, the recorder, counts and latencies."""
