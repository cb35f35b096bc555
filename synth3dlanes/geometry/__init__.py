"""Frames, polylines and lenses."""
