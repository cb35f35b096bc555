"""The location of the built-in assets."""

from pathlib import Path


def assets_dir() -> Path:
    """The folder of the built-in assets: inside the package in an installed wheel, beside it in a checkout."""
    package = Path(__file__).resolve().parents[2]
    installed = package / "_assets"
    return installed if installed.is_dir() else package.parent / "blender_assets"
