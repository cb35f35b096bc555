"""Rebuild every asset beside this file from code alone: `python blender_assets/make.py`."""

from pathlib import Path

from library import make_library
from sky import make_clouds, make_sky
from textures import make_textures

HERE = Path(__file__).resolve().parent


def main() -> None:
    """Write textures, sky and the .blend library."""
    make_textures(HERE / "textures")
    make_sky(HERE / "sky.npz")
    make_clouds(HERE / "textures")
    make_library(HERE / "assets.blend")


if __name__ == "__main__":
    main()
