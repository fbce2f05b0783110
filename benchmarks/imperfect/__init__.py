"""Imperfect instruments: what each imperfection costs, with and without its correction, and many of them at once."""
