"""COCO: panoptic and instance segmentation."""
