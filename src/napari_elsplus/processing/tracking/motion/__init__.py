"""Motion of the probe: rolling shutter, poses, prediction, and the prior that they give a warp."""
