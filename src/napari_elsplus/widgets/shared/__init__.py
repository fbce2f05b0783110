"""What several panels share: the panel itself, plots, long work, the connection to the engine."""
