"""Apollo Sim-3D / Gen-LaneNet."""
