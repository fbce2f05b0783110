"""A virtual DAQ card, behind gRPC or in place of the C library."""
