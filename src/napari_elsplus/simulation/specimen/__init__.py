"""What is looked at, and how the probe moves over it."""
