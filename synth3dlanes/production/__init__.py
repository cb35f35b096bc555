"""Everything about many samples: recipe, workers, runs on one machine or a cluster, twins, bench."""
