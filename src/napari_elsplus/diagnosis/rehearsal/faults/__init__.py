"""Functions that play the faults, registered when they are imported."""
