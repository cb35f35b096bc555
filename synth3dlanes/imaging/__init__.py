"""From light to picture in numpy: sky and daylight, haze, lens, sensor, film. No Blender, which only traces rays."""
