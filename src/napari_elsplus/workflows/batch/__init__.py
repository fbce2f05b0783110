"""Many recordings at once, on the workers of a dask scheduler; a batch that was interrupted is resumed."""
