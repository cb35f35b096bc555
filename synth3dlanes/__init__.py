"""Synthetic 3D-lane images with exact ground truth."""

__version__ = "0.2.0"
