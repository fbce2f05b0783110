"""The live mosaic: tracking, insertion, loop closure, and its board in shared memory."""
