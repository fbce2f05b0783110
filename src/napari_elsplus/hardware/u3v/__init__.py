"""USB3 Vision over pyusb: packets, control channel, stream, and the camera made of them."""
