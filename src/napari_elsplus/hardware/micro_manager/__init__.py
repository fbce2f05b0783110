"""A camera of Micro-Manager, through its device adapters."""
