"""The model instrument: optics, fibre bundle, laser line, axial response."""
