"""A virtual USB3 Vision camera on a virtual USB bus."""
