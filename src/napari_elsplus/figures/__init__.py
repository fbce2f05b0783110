"""Pictures for files, made without a screen."""
