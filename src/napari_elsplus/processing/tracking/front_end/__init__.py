"""Raw frame to the image that is tracked: binning, grid, sampling."""
