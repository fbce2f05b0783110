"""The scan at full speed: its lag, the row error of every row, the galvo's response, and the ramp learned from them."""
