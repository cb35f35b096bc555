"""OpenLane-V2."""
