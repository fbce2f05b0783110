"""Raw camera frames of a specimen seen through the model instrument."""
