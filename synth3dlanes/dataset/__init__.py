"""Samples on disk: tar shards with a parquet index. Needs neither Blender nor torch."""
