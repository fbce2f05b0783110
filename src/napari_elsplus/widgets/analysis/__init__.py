"""The Compare, Axial response and Quality panels."""
