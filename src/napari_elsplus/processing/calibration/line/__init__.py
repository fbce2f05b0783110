"""The laser line in one view: search, location, scatter from frame to frame."""
