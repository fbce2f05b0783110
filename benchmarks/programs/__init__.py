"""Programs that measure one thing each, by hand or by asv: ``python -m benchmarks.programs.NAME``."""
