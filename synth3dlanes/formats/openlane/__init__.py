"""OpenLane v1."""
