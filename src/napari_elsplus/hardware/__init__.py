"""Camera and galvo: the protocols, the drivers, and virtual devices that speak the real ones' language."""
