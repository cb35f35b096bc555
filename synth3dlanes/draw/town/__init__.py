"""Towns: junctions, streets, traffic and furniture of scenes with a map of their own (docs/town.md)."""
