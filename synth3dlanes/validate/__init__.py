"""Validation of a dataset: its files are complete and its labels agree with its pixels. Needs no Blender."""
