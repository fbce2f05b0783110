"""Commands about a rig, simulated or real, and about this computer."""
