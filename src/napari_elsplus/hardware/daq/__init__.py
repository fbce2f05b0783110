"""The galvo on a National Instruments card, through nidaqmx."""
