"""Resolution, image quality, and the statistics that they rest on."""
