"""Parameters and what they are made of: distributions, cameras, lidars and rigs, shots, weather."""
