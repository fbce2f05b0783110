"""Pure functions: arrays in, arrays or frozen dataclasses out. They read like the paper's Methods."""
