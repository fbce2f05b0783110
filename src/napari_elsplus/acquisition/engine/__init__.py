"""The live engine: camera and galvo in step, every frame sectioned, displayed, recorded."""
