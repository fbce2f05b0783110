"""Files: recordings, calibrations, tracks, all written beside and renamed."""
