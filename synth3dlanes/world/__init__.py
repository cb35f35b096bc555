"""World and View: the ground as built, what stands on it, what is seen."""
