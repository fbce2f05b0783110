"""The Rig and Live panels."""
