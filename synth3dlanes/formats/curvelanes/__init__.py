"""CurveLanes."""
