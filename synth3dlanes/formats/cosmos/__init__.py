"""Cosmos: control videos of a clip, and its world scenario as ClipGT tables."""
