"""nuScenes: the tables of its devkit (v1.0) with cameras, lidar and boxes, and its map expansion."""
