"""Raw frame to LS, residual, ELS+ and ELSA: sectioning, resampling, the core pattern."""
