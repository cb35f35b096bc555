"""A user's cameras, rigs and lidars: what they are like, the files that say so, and a lidar's sweep."""
