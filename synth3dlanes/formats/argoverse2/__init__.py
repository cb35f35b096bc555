"""Argoverse 2: its sensor data set and its maps, a log for each scene."""
