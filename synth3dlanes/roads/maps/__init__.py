"""Given maps: OpenDRIVE files as roads, junctions and paint in the terms of `road_map`."""
