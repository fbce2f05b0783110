"""A bench without a rig: virtual devices at the lowest level, so that the drivers above them are the real ones.

One clock runs through it: the camera's strobe starts the card's waveform, the galvo follows it with its lag, and the
frame is rendered with the laser line where the mirror put it. A wrong ramp gives a wrong image.
"""
