"""The two images of the bundle: location, rim, matched cores, view alignment and gain."""
