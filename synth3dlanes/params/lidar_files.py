"""Files of lidars (docs/lidar.md). Reading a file is the only side effect."""

from synth3dlanes.params.camera_files import read_as
from synth3dlanes.params.lidars import LidarSpec
from synth3dlanes.params.params import find_preset


def load_lidar(source: str) -> LidarSpec:
    """Read a ready lidar (by name) or a YAML file; raise InputError with a line for every problem."""
    return read_as(LidarSpec, *find_preset(source, "lidars"), "lidar")
