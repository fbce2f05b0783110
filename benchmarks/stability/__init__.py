"""Where methods fail, how soon, and whether they know it: a failure map for each estimator."""
