"""Programs that measure one thing each, or try the tests: commands of ``python3 run.py bench``; asv runs `defaults`."""
