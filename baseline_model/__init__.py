"""The bundled baseline: 3D-LaneNet (paper, sections 3 and 4), its ablations, its metric and smaller variants."""
