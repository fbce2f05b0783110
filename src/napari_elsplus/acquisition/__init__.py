"""The live engine: camera, processing and recorder at the camera's pace, in this process or in one of its own."""
