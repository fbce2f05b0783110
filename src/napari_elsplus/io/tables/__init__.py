"""Tables as text: voltages and depths, and the track of a probe."""
