"""A bench without a rig: virtual devices at the lowest level, below the unmodified drivers.

One clock runs through it: the camera's strobe starts the card's waveform, the galvo follows it with its lag, and the
frame is rendered with the laser line where the galvo is. A wrong ramp gives a wrong image.
"""
