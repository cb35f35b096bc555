"""Roads: the paper's numbers or a map -> Network; OpenDRIVE read."""
