"""Base classes of docked panels, plots, background work, and the shared connection to the engine."""
