"""Programs that measure one thing each, or try the tests: each is a command of ``python3 run.py bench``."""
