"""The bundled baseline: 3D-LaneNet (sections 3 and 4 of the paper), its ablations, its metric and smaller relatives."""
