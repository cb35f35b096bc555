"""Lift: lanes of real drives in 3D, from their lidar, their poses, and lines marked in images or in the top view."""
