"""From raw frames to the path of the probe: front end, registration, evidence, key frames, loops."""
