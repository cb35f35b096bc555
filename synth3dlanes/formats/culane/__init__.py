"""CULane."""
