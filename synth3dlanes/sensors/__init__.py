"""A user's cameras, rigs and lidars, their files, and the sweep of a lidar."""
