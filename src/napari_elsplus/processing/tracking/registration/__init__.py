"""Registration of two frames: shift search, Lucas-Kanade, motion models, evidence."""
