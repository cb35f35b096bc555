"""tuSimple."""
