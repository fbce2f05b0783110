"""The galvo's drive over one frame: timing, path of the line, waveform."""
