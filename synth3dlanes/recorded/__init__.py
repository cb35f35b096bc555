"""Drives of real cars, and lanes lifted from them."""
