"""Pictures of results for files, made without a screen."""
