"""Params -> Scene."""
