"""Files of lidars (docs/lidar.md). Reading a file is the only side effect."""

from pathlib import Path

from pydantic import ValidationError

from synth3dlanes.errors import InputError
from synth3dlanes.params import presets_folder
from synth3dlanes.schema import shown, validation_problems
from synth3dlanes.sensors.camera_files import read_document
from synth3dlanes.sensors.lidars import LidarSpec


def lidar_names() -> list[str]:
    """The names of the ready lidars."""
    return sorted(path.stem for path in (presets_folder() / "lidars").glob("*.yaml"))


def load_lidar(source: str) -> LidarSpec:
    """Read a ready lidar (by name) or a YAML file; raise InputError with a line for every problem."""
    if source in lidar_names():
        path, where = presets_folder() / "lidars" / f"{source}.yaml", f"params/lidars/{source}.yaml"
    elif Path(source).suffix in (".yaml", ".yml"):
        path, where = Path(source), source
    else:
        raise InputError(f"lidar {source}: expected one of {', '.join(lidar_names())}, or the path of a .yaml file")
    document = read_document(path, where)
    if not isinstance(document, dict):
        raise InputError(f"{where}: expected the keys of a lidar, got {shown(document)}")
    try:
        return LidarSpec.model_validate(document)
    except ValidationError as error:
        raise InputError(*validation_problems(error, where)) from None
