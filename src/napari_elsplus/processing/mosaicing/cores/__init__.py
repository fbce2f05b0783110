"""Mosaics finer than the cores: every core is a point sample of the specimen at its own place in each frame."""
