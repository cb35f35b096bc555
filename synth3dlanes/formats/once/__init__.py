"""ONCE-3DLanes."""
