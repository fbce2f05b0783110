"""File formats of recordings and images, a module for each."""
