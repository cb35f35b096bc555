"""Files of lidars (docs/lidar.md). Reading a file is the only side effect."""

from pydantic import ValidationError

from synth3dlanes.params.camera_files import read_document
from synth3dlanes.params.lidars import LidarSpec
from synth3dlanes.params.params import find_preset
from synth3dlanes.system.errors import InputError
from synth3dlanes.system.schema import shown, validation_problems


def load_lidar(source: str) -> LidarSpec:
    """Read a ready lidar (by name) or a YAML file; raise InputError with a line for every problem."""
    path, where = find_preset(source, "lidars")
    document = read_document(path, where, is_calibration=False)
    if not isinstance(document, dict):
        raise InputError(f"{where}: expected the keys of a lidar, got {shown(document)}")
    try:
        return LidarSpec.model_validate(document)
    except ValidationError as error:
        raise InputError(*validation_problems(error, where)) from None
