"""From light to picture in numpy: sky and daylight, haze, lens, sensor, tone curve. Blender only traces rays."""
