"""Raw camera frames of a specimen, from the model of the instrument."""
