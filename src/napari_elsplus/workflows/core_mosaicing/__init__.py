"""Mosaics sampled core by core, from raw recordings and from stacks of bundle images."""
