"""Whole jobs, without a screen: what a button or a command does is one function here."""
