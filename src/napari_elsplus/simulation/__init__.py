"""Model of the instrument: raw camera frames of a specimen from optics, scan and camera noise; no device."""
