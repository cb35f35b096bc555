"""Plain PNG masks."""
