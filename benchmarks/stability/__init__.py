"""Failure maps: levels of stress at which each estimator fails, detected or silently."""
