"""Commands from files to files."""
