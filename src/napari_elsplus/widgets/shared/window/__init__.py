"""Main window of a docked panel: keys, paint events, layer list, and the question before it closes."""
