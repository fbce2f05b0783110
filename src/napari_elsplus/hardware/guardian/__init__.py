"""The guardian: a process that parks the galvo where the one that drives it cannot."""
