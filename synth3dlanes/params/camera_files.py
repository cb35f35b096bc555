"""Files of cameras: our own YAML, and the calibrations that OpenCV, ROS, Kalibr and CamOdoCal write
(docs/camera.md).

Reading a file is the only side effect.
"""

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from synth3dlanes.params.cameras import LAST, NAMES, CameraSpec
from synth3dlanes.params.params import find_preset
from synth3dlanes.system.errors import InputError
from synth3dlanes.system.schema import MAX_PROBLEMS, problem_line, shown, unknown_key, validation_problems
from synth3dlanes.system.yaml_text import read_yaml, text_of

Model = TypeVar("Model", bound=BaseModel)

# Short names of keys in files.
SHORT = {name: f"{name}_px" for name in ("fx", "fy", "cx", "cy")}
# OpenCV, ROS, Kalibr and CamOdoCal put (0, 0) at the centre of the first pixel, we at its corner.
CENTER_PX = 0.5
# The coefficients that a list has by the model, in order, and how many there may be.
LISTED: dict[str, tuple[tuple[str, ...], tuple[int, ...]]] = {
    "opencv": (NAMES, (4, 5, 8, 12, 14)),
    "fisheye": (("k1", "k2", "k3", "k4"), (4,)),
    "omni": (("k1", "k2", "p1", "p2"), (4,)),
}
# For each camera model of Kalibr: its intrinsics before fx fy cx cy, and our model for each of its distortion models.
KALIBR_MODELS: dict[str, tuple[tuple[str, ...], dict[str, str]]] = {
    "pinhole": ((), {"none": "pinhole", "radtan": "opencv", "equidistant": "fisheye"}),
    "omni": (("xi",), {"none": "omni", "radtan": "omni"}),
}
ROS_MODELS = {
    "plumb_bob": "opencv",
    "rational_polynomial": "opencv",
    "equidistant": "fisheye",
    "fisheye": "fisheye",
    "none": "pinhole",
}


def load_camera(source: str) -> CameraSpec:
    """Read a ready camera (by name) or a file; raise InputError with a line for every problem."""
    path, where = find_preset(source, "cameras")
    return read_camera(read_document(path, where), where, path.parent)


def read_camera(document: Any, where: str, folder: Path) -> CameraSpec:
    """The camera of a parsed file, or of a part of one; paths in it are relative to `folder`.

    Raises InputError with a line for every problem, each beginning with `where`.
    """
    if not isinstance(document, dict):
        raise InputError(f"{where}: expected keys of a camera such as width_px, got {shown(document)}")
    keys = {key: value for key, value in document.items() if key != "calibration"}
    if "calibration" in document:
        keys = {**_calibrated(document["calibration"], where, folder), **keys}
    else:
        keys = _foreign(keys, where) if _is_foreign(keys) else keys
    keys, problems = _own(keys, where)
    try:
        spec = CameraSpec.model_validate(keys)
    except ValidationError as error:
        problems += _problems(error, where)
        raise InputError(*problems[:MAX_PROBLEMS]) from None
    if problems:
        raise InputError(*problems)
    # Values that do not go together show at the ends of the ranges, if not everywhere.
    for u in (0.0, 0.5, LAST):
        try:
            spec.drawn(partial(float, u))
        except InputError as error:
            raise InputError(*(f"{where}: {problem.removeprefix('camera: ')}" for problem in error.problems)) from None
    return spec


def read_document(path: Path, where: str, *, is_calibration: bool = True) -> Any:
    """What a YAML file says, of OpenCV's kind too; raise InputError with a line for every problem."""
    document, problems = read_yaml(text_of(path, where), where, is_calibration=is_calibration)
    if problems:
        raise InputError(*problems)
    return document


def read_as(model: type[Model], path: Path, where: str, what: str) -> Model:
    """The `what` that a YAML file has the keys of; raise InputError with a line for every problem."""
    document = read_document(path, where, is_calibration=False)
    if not isinstance(document, dict):
        raise InputError(f"{where}: expected the keys of a {what}, got {shown(document)}")
    try:
        return model.model_validate(document)
    except ValidationError as error:
        raise InputError(*validation_problems(error, where)) from None


def _own(document: Mapping[Any, Any], where: str) -> tuple[dict[str, Any], list[str]]:
    """The keys of `CameraSpec`: K and short names are resolved."""
    keys: dict[str, Any] = {}
    problems: list[str] = []
    for key, value in document.items():
        if not isinstance(key, str) or not key.isidentifier():
            problems.append(f"{where}: {shown(key)}: unknown key")
            continue
        if key == "K":
            matrix = _numbers(value)
            if len(matrix) != 9 or matrix[1] or matrix[3] or matrix[6] or matrix[7] or matrix[8] != 1:
                problems.append(f"{where}: K: expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], got {shown(value)}")
            else:
                keys |= {"fx_px": matrix[0], "cx_px": matrix[2], "fy_px": matrix[4], "cy_px": matrix[5]}
        else:
            keys[SHORT.get(key, key)] = value
    return keys, problems


def _calibrated(source: Any, where: str, folder: Path) -> dict[str, Any]:
    """The image and lens that a calibration file says, for a camera whose place the own file says."""
    if not isinstance(source, str):
        raise InputError(f"{where}: calibration: expected the path of a calibration file, got {shown(source)}")
    path = folder / source
    document = read_document(path, f"{where}: calibration {source}")
    if not isinstance(document, dict) or not _is_foreign(document):
        raise InputError(f"{where}: calibration {source}: expected a calibration of OpenCV, ROS, Kalibr or CamOdoCal")
    return _foreign(document, f"{where}: calibration {source}")


def _is_foreign(document: Mapping[Any, Any]) -> bool:
    keys = {key.lower() for key in document if isinstance(key, str)}
    one_of = "camera_matrix" in keys or "cam0" in keys or "mirror_parameters" in keys
    return one_of or {"intrinsics", "resolution"} <= keys


def _foreign(document: Mapping[Any, Any], where: str) -> dict[str, Any]:
    """The image and lens of a calibration, by the keys of `CameraSpec`."""
    keys = {key.lower(): value for key, value in document.items() if isinstance(key, str)}
    if "mirror_parameters" in keys:
        return _of_camodocal(keys, where)
    return _of_opencv(keys, where) if "camera_matrix" in keys else _of_kalibr(keys.get("cam0", keys), where)


def _of_opencv(keys: Mapping[str, Any], where: str) -> dict[str, Any]:
    """OpenCV's FileStorage, and ROS's camera_info, which has the same names."""
    matrix = _numbers(keys["camera_matrix"])
    if len(matrix) != 9:
        raise InputError(f"{where}: camera_matrix: expected 9 numbers, got {shown(keys['camera_matrix'])}")
    values = _numbers(keys.get("distortion_coefficients", ()))
    told = keys.get("distortion_model", keys.get("model"))
    if told is None:
        model = "fisheye" if keys.get("fisheye_model") else "opencv"
    else:
        model = _model(told, ROS_MODELS, where, "distortion_model")
    size = {name: _required(keys, f"image_{name.removesuffix('_px')}", where) for name in ("width_px", "height_px")}
    return {**size, **_centered(matrix[0], matrix[4], matrix[2], matrix[5]), **_lens(model, values, where)}


def _of_kalibr(cam: Any, where: str) -> dict[str, Any]:
    """A camera of Kalibr's camchain."""
    if not isinstance(cam, dict):
        raise InputError(f"{where}: cam0: expected keys such as intrinsics, got {shown(cam)}")
    kind = cam.get("camera_model", "pinhole")
    if not isinstance(kind, str) or kind not in KALIBR_MODELS:
        raise InputError(f"{where}: camera_model: expected {' or '.join(KALIBR_MODELS)}, got {shown(kind)}")
    first, models = KALIBR_MODELS[kind]
    intrinsics, size = (_numbers(_required(cam, key, where)) for key in ("intrinsics", "resolution"))
    names = (*first, "fx", "fy", "cx", "cy")
    if len(intrinsics) != len(names) or len(size) != 2:
        raise InputError(f"{where}: expected intrinsics [{', '.join(names)}] and resolution [width, height]")
    model = _model(cam.get("distortion_model", "none"), models, where, "distortion_model")
    lens = _lens(model, _numbers(cam.get("distortion_coeffs", ())), where)
    lens |= dict(zip(first, intrinsics, strict=False))
    return {"width_px": size[0], "height_px": size[1], **_centered(*intrinsics[-4:]), **lens}


def _of_camodocal(keys: Mapping[str, Any], where: str) -> dict[str, Any]:
    """CamOdoCal's omnidirectional camera, the model of KITTI-360's fisheyes."""
    size = [_required(keys, name, where) for name in ("image_width", "image_height")]
    groups = {
        "projection_parameters": ("gamma1", "gamma2", "u0", "v0"),
        "mirror_parameters": ("xi",),
        "distortion_parameters": ("k1", "k2", "p1", "p2"),
    }
    found = []
    for group, names in groups.items():
        values = _required(keys, group, where)
        if not isinstance(values, dict) or len(read := _numbers([values.get(name) for name in names])) != len(names):
            raise InputError(f"{where}: {group}: expected the numbers {' '.join(names)}, got {shown(values)}")
        found.append(read)
    focals, xi, distortion = found
    return {
        "width_px": size[0],
        "height_px": size[1],
        **_centered(*focals),
        **_lens("omni", distortion, where),
        "xi": xi[0],
    }


def _centered(fx: float, fy: float, cx: float, cy: float) -> dict[str, Any]:
    return {"fx_px": fx, "fy_px": fy, "cx_px": cx + CENTER_PX, "cy_px": cy + CENTER_PX}


def _lens(model: str, values: list[float], where: str) -> dict[str, Any]:
    """The coefficients by name."""
    if model == "pinhole" or not any(values):
        return {"model": "pinhole" if model == "opencv" else model}
    names, counts = LISTED[model]
    if len(values) not in counts:
        *others, last = map(str, counts)
        wanted = f"{', '.join(others)} or {last}" if others else last
        told = f"expected {wanted} coefficients of the model {model}, got {len(values)}"
        raise InputError(f"{where}: distortion: {told}")
    return {"model": model, **dict(zip(names, values, strict=False))}


def _model(told: Any, known: Mapping[str, str], where: str, key: str) -> str:
    if not isinstance(told, str) or told not in known:
        raise InputError(f"{where}: {key}: expected one of {', '.join(known)}, got {shown(told)}")
    return known[told]


def _required(keys: Mapping[Any, Any], key: str, where: str) -> Any:
    if key not in keys:
        raise InputError(f"{where}: {key}: missing key")
    return keys[key]


def _numbers(value: Any) -> list[Any]:
    """The numbers of a list, of rows or of an OpenCV matrix; none where there is anything else."""
    if isinstance(value, dict):
        value = value.get("data")
    rows = value if isinstance(value, list | tuple) else ()
    flat = [item for row in rows[:16] for item in (row[:16] if isinstance(row, list | tuple) else [row])]
    return flat if all(isinstance(item, int | float) and not isinstance(item, bool) for item in flat) else []


def _problems(error: ValidationError, where: str) -> list[str]:
    lines = []
    for problem in error.errors():
        path = ".".join(str(step) for step in problem["loc"])
        line = problem_line(problem)
        if problem["type"] == "extra_forbidden":
            line = f"{path}: {unknown_key(path, (*CameraSpec.model_fields, 'calibration', 'K'))}"
        elif problem["type"] == "value_error" and path:
            line += f", got {shown(problem['input'])}"
        lines.append(f"{where}: {line}")
    return lines
