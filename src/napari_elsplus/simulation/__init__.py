"""The instrument's optics as a model: scene to raw camera frames; no device."""
