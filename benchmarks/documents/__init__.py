"""Charts and tables of the documentation; ``python3 run.py bench docs`` makes them."""
