"""Drives of real cars: what their sensors saw, where they were, and where their lanes were marked."""
