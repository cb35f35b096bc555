"""Maps of scenes as OpenDRIVE files."""
