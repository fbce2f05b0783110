"""Camera and galvo: the protocols, the drivers, and virtual devices that speak the real ones' language."""

import os

# gRPC reads it when it is imported, and else writes to the terminal of servers that end.
os.environ.setdefault("GRPC_VERBOSITY", "ERROR")
