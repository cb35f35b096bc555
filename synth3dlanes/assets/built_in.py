"""Where the project's own assets lie."""

from pathlib import Path


def assets_dir() -> Path:
    """The folder of built assets: inside an installed wheel, beside the package in a checkout."""
    package = Path(__file__).resolve().parents[1]
    installed = package / "_assets"
    return installed if installed.is_dir() else package.parent / "blender_assets"
