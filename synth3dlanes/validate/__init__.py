"""Proof that a dataset is whole and that its labels fit its own pixels. Reads a dataset; needs no Blender."""
