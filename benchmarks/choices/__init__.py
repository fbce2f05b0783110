"""The choices that the software makes, a module for each: cases with known truth, methods, a judge."""
