"""The ELS+ dock: all panels as tabs, with one status line."""
