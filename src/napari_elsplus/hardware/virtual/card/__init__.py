"""A virtual DAQ card behind gRPC."""
