"""KITTI's object detection: 3D boxes in the frame of the camera (`_cv`: x right, y down, z forward)."""
