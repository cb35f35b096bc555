"""Job: one value that says which data to make. The command line, Python and files of jobs have its fields.

Reading the files that it names is the only side effect.
"""

import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import (
    BaseModel,
    BeforeValidator,
    Discriminator,
    Field,
    InstanceOf,
    SkipValidation,
    Tag,
    ValidationError,
    model_validator,
)
from pydantic_core import ErrorDetails

from synth3dlanes import __version__
from synth3dlanes.dataset.description import DATASET_FORMAT, DESCRIPTION, SplitName, parse_description
from synth3dlanes.dataset.scenes import Provenance, read_provenance
from synth3dlanes.draw.given_map import MapPlace, place_on_map
from synth3dlanes.draw.like import DrawKey, Neighbourhood, read_like
from synth3dlanes.draw.sample import Scenes
from synth3dlanes.params.camera_files import load_camera
from synth3dlanes.params.cameras import CameraSpec
from synth3dlanes.params.lidar_files import load_lidar
from synth3dlanes.params.lidars import LidarSpec
from synth3dlanes.params.params import BASE, Params, load_params
from synth3dlanes.params.params_text import contradictions
from synth3dlanes.params.rig_files import load_rig
from synth3dlanes.params.shots import Shots, clips
from synth3dlanes.production.events import Event
from synth3dlanes.production.given_scenes import drawn, given_scenes
from synth3dlanes.production.plan import Plan
from synth3dlanes.production.recipe import Condition, Recipe, fitting_world
from synth3dlanes.production.run import generate
from synth3dlanes.production.tally import RunReport, total
from synth3dlanes.production.user_assets import open_library
from synth3dlanes.scene.assets.catalogue import BUILT_IN, Library
from synth3dlanes.scene.host import MAX_CAMERAS, MAX_FRAMES
from synth3dlanes.scene.scene import Scene
from synth3dlanes.scene.settings import MAX_SAMPLES, MAX_SEED, MAX_VIEWS, PASSES, QUALITY_SAMPLES, TRIES, RenderSettings
from synth3dlanes.system.errors import InputError
from synth3dlanes.system.files import write
from synth3dlanes.system.schema import DocumentPart, problem_line, shown, unknown_key
from synth3dlanes.system.yaml_text import read_yaml, text_of, to_yaml

# The scene's parameters that a camera or rig file replaces: all but the host's place on the road.
KEYS_OF_CAMERA_FILES = (
    *("camera.height_m", "camera.pitch_deg", "camera.width_px", "camera.height_px", "camera.horizontal_fov_deg"),
    *("camera.roll_deg", "camera.principal_offset_px"),
)
# Parameters without effect on a given map, which has these properties itself.
KEYS_OF_ROADS = (
    *("road.", "town.", "town_streets.", "mountain.", "symbols.", "roadside.", "structures."),
    *("camera.lane", "camera.y_m", "cars.parked"),
)
# The parameters that say which scenes use a group that not all of them use.
SWITCHES = ("town.junction", "mountain.road", "works.present")
# Fields that exclude each other, and fields that have no effect without another field.
EXCLUSIVE = (
    *(("n", "splits"), ("split", "splits"), ("camera", "rig"), ("samples", "quality")),
    *(("like", "map"), ("like", "where")),
)
NEEDED = {"spreads": "like", "at": "map", "tries": "where"}
# Fields that always name files, and fields that may name something built in.
FILES, NAMES = ("out", "like", "map", "assets"), ("params", "camera", "rig", "lidar")


class OptionForm(NamedTuple):
    """How a field is an option of the command line, where that does not follow from its name and type."""

    metavar: str | None = None
    name: str | None = None
    default: str | None = None
    presets: str | None = None


def _text(value: Any) -> Any:
    if isinstance(value, str | os.PathLike):
        if "\0" in (text := os.fspath(value)) or not text:
            raise ValueError(f"expected text without a null character and not empty, got {shown(text)}")
        return text
    return value


def _split_name(value: Any) -> Any:
    if not isinstance(value, str) or re.fullmatch("[A-Za-z0-9_-]{1,200}", value) is None:
        raise ValueError(f"expected letters, digits, - and _, got {shown(value)}")
    return value


def _splits(value: Any) -> Any:
    """Splits with their numbers of samples, from a mapping or from text such as train=800,val=100."""
    if not isinstance(value, str):
        return value
    found = {}
    for text in value.split(","):
        name, _, count = text.strip().partition("=")
        if not re.fullmatch("[0-9]{1,9}", count) or name in found:
            raise ValueError(f"expected splits such as train=800,val=100, got {shown(value)}")
        found[name] = int(count)
    return found


def _several(value: Any) -> Any:
    return [value] if isinstance(value, str) else value


def _passes(value: Any) -> Any:
    """Passes in their order, from a list, `all`, or names with commas."""
    names = (
        [name.strip() for name in value.split(",") if name.strip() not in ("", "none")]
        if isinstance(value, str)
        else value
    )
    if names == ["all"]:
        return PASSES
    if isinstance(names, Sequence) and (wrong := [name for name in names if name not in PASSES]):
        raise ValueError(f"expected one of {', '.join(PASSES)}, or all, got {shown(wrong[0])}")
    return [name for name in PASSES if name in names] if isinstance(names, Sequence) else names


def _workers(value: Any) -> Any:
    if isinstance(value, str) and re.fullmatch("0*[1-9][0-9]{0,8}", value):
        return int(value)
    if isinstance(value, bool) or not (value == "auto" or (isinstance(value, int) and value >= 0)):
        raise ValueError(f"expected auto or a number of processes, got {shown(value)}")
    return 0 if value == "auto" else value


def _part(value: Any) -> Any:
    found = re.fullmatch(r"([0-9]{1,9})/([0-9]{1,9})", value) if isinstance(value, str) else None
    numbers = (int(found[1]), int(found[2])) if found else value
    is_pair = isinstance(numbers, list | tuple) and len(numbers) == 2 and all(type(each) is int for each in numbers)
    if not is_pair or not 1 <= numbers[0] <= numbers[1]:
        raise ValueError(f"expected i/n with 1 <= i <= n, such as 2/8, got {shown(value)}")
    return numbers


def _kind(value: Any) -> str:
    return "text" if isinstance(value, str | os.PathLike) else "keys"


def either(words: str, *kinds: type) -> BeforeValidator:
    """A check that a value is of one of these types; `words` say to the user what was expected."""

    def check(value: Any) -> Any:
        if not isinstance(value, kinds):
            raise ValueError(f"expected {words}, got {shown(value)}")
        return value

    return BeforeValidator(check)


Text = Annotated[str, BeforeValidator(_text), Tag("text")]
Texts = Annotated[tuple[Annotated[str, BeforeValidator(_text)], ...], BeforeValidator(_several)]
BY_KIND = Discriminator(_kind)
# What stands in place of a name or a file: keys of a document, or a value of this library.
KEYS = Tag("keys")
OwnParams = Annotated[
    SkipValidation[Params | dict[str, Any]],
    either("the name of a preset, a file, or groups of parameters", Params, dict),
    KEYS,
]
OwnCamera = Annotated[CameraSpec, either("a name, a file, or keys of a camera", CameraSpec, dict), KEYS]
OwnRig = Annotated[
    tuple[CameraSpec, ...], Field(max_length=MAX_CAMERAS), either("a name, a file, or cameras", list, tuple), KEYS
]
OwnLidar = Annotated[LidarSpec, either("a name, a file, or keys of a lidar", LidarSpec, dict), KEYS]
OpenAssets = Annotated[InstanceOf[Library], either("a folder of assets", Library), KEYS]
# A scene, or what it was drawn for.
GivenScene = Annotated[
    Annotated[InstanceOf[Scene], Tag("scene")] | Annotated[DrawKey, Tag("draw")],
    Discriminator(lambda value: "scene" if isinstance(value, Scene) else "draw"),
]
GivenScenes = Annotated[tuple[GivenScene, ...], either("a file or scenes", list, tuple), KEYS]
# Steps of pydantic's paths that are no keys of a document.
TAGS = ("text", "keys", "scene", "draw", "[key]")


def told(about: str, **bounds: Any) -> Any:
    """A field with its help, and the bounds of its value."""
    return Field(description=about, **bounds)


def number(about: str, **bounds: Any) -> Any:
    """A field of a number, which no text stands for."""
    return Field(description=about, strict=True, **bounds)


class Job(DocumentPart):
    """Which data to make, and where. Its fields are the options of `synth3dlanes generate`; in Python, values of this
    library (`Params`, `CameraSpec`, `Library`, `Scene`) may take the place of names and paths.

    Raises InputError with a line for every field that is wrong or has no effect.
    """

    n: Annotated[int | None, number("Number of samples in the split.", ge=0, le=MAX_SAMPLES)] = None
    out: Annotated[
        str | None,
        BeforeValidator(_text),
        told("Data set to create or extend: a folder, or a URL such as s3://lanes/v1."),
        OptionForm("DIR"),
    ] = None
    split: Annotated[
        str,
        BeforeValidator(_split_name),
        told("Name of the split. Splits of other names have other scenes."),
        OptionForm("NAME"),
    ] = "train"
    splits: Annotated[
        dict[SplitName, Annotated[int, Field(ge=0, le=MAX_SAMPLES, strict=True)]],
        BeforeValidator(_splits),
        told("Several splits with their numbers of samples, in place of --n and --split."),
        OptionForm("NAME=N,..."),
    ] = Field(default_factory=dict)
    seed: Annotated[int, number("Random seed of the data set.", ge=0, le=MAX_SEED)] = 0
    params: Annotated[
        Text | OwnParams,
        BY_KIND,
        told("Parameters: a YAML file or the name of a preset (`list presets`)."),
        OptionForm("FILE", presets=""),
    ] = "appendix_i"
    set: Annotated[
        Texts,
        told("Change one parameter, such as light.exposure=3; repeatable."),
        OptionForm("GROUP.KEY=VALUE"),
    ] = ()
    like: Annotated[
        Text | GivenScenes,
        BY_KIND,
        told("Draw scenes near those in FILE, or near the worst in a result of evaluate --json (docs/like.md)."),
        OptionForm("FILE"),
    ] = ()
    spreads: Annotated[
        Texts,
        told("With --like: share of a parameter's range in which it varies; repeatable."),
        OptionForm("SHARE|GROUP.KEY=SHARE", "--spread", "0.1"),
    ] = ()
    map: Annotated[
        str | None,
        BeforeValidator(_text),
        told("Place scenes on the roads of an OpenDRIVE or Lanelet2 file (docs/maps.md)."),
        OptionForm("FILE"),
    ] = None
    at: Annotated[str, told("With --map: the host's place, in place of a random one."), OptionForm("ROAD:S:LANE")] = ""
    where: Annotated[
        str,
        told(
            'Draw scenes for each sample until one fits, by columns of the index: "max_grade > 0.04 and junction = '
            "'merge'\" (docs/recipes.md)."
        ),
        OptionForm("QUERY"),
    ] = ""
    tries: Annotated[int, number("With --where: most scenes to draw for a sample.", ge=1)] = TRIES
    camera: Annotated[
        Annotated[Text | OwnCamera, BY_KIND] | None,
        told(
            "Your camera instead of that of the parameters: a YAML file, also of OpenCV or Kalibr, or the name of a "
            "ready one (`list cameras`, docs/camera.md)."
        ),
        OptionForm("FILE|NAME", presets="cameras"),
    ] = None
    rig: Annotated[
        Text | OwnRig,
        BY_KIND,
        told(
            "Several cameras that see every scene: a YAML file, or the name of a ready rig (`list rigs`, "
            "docs/camera.md)."
        ),
        OptionForm("FILE|NAME", presets="rigs"),
    ] = ()
    assets: Annotated[
        Annotated[Text | OpenAssets, BY_KIND] | None,
        told("Folder of your own cars, trees, textures and skies (docs/assets.md)."),
        OptionForm("DIR"),
    ] = None
    frames: Annotated[
        int,
        number(
            "Frames of each scene: with 20, samples 0 to 19 are a clip of scene 0 (docs/clips.md).", ge=1, le=MAX_FRAMES
        ),
    ] = 1
    views_per_scene: Annotated[
        int,
        number(
            "Pictures of each scene from several places of the host, in other light (docs/views.md).",
            ge=1,
            le=MAX_VIEWS,
        ),
    ] = 1
    fps: Annotated[float, number("Frames per second of clips.", gt=0, le=1000)] = 10.0
    workers: Annotated[
        int,
        BeforeValidator(_workers),
        told(
            "Worker processes. auto: one per core and GB of memory that may be used, or up to four per GPU. With Ray: "
            "cores per task."
        ),
        OptionForm("N|auto", default="auto"),
    ] = 0
    device: Annotated[
        Literal["auto", "cpu", "cuda", "optix", "hip", "oneapi", "metal"], told("Device to render on.")
    ] = "auto"
    quality: Annotated[
        Literal["train", "draft", "standard", "high"],
        told(f"Samples per pixel: {', '.join(f'{name} {samples}' for name, samples in QUALITY_SAMPLES.items())}."),
    ] = "standard"
    samples: Annotated[
        int | None, number("Samples per pixel, in place of --quality.", ge=1, le=1_000_000), OptionForm("K")
    ] = None
    passes: Annotated[
        tuple[Literal["depth", "normal", "semantic", "instance", "height"], ...],
        BeforeValidator(_passes),
        told(f"Extra images to write as OpenEXR, separated by commas, or all: {', '.join(PASSES)}."),
        OptionForm("NAMES"),
    ] = ()
    lidar: Annotated[
        Annotated[Text | OwnLidar, BY_KIND] | None,
        told("Lidar on the host: a YAML file or the name of a ready one (`list lidars`, docs/lidar.md)."),
        OptionForm("FILE", presets="lidars"),
    ] = None
    image_format: Annotated[
        Literal["jpg", "png"], told("jpg has quality 95 (sensor.jpeg_quality); png is lossless.")
    ] = "jpg"
    executor: Annotated[Literal["local", "ray"], told("Where to run: on this machine or on a Ray cluster.")] = "local"
    address: Annotated[
        str, told("Address of the Ray cluster. auto: the cluster this machine belongs to."), OptionForm("TEXT")
    ] = "auto"
    part: Annotated[
        tuple[int, int],
        BeforeValidator(_part),
        told("Make only part I of N, for example one part per machine."),
        OptionForm("I/N", default="1/1"),
    ] = (1, 1)

    def __init__(self, **fields: Any) -> None:
        # What is None is left out; numbers of numpy are numbers.
        given = {name: value for name, value in fields.items() if value is not None}
        given = {name: value.item() if isinstance(value, np.generic) else value for name, value in given.items()}
        try:
            super().__init__(**given)
        except ValidationError as error:
            raise InputError(*(line for problem in error.errors() for line in _lines(problem))) from None

    @model_validator(mode="after")
    def _has_effect(self) -> "Job":
        """Raise ValueError with a line for each field that has no effect beside the others."""
        given = {name for name in self.model_fields_set if getattr(self, name) not in ("", ())}
        problems = [f"{two}: expected none beside {one}" for one, two in EXCLUSIVE if {one, two} <= given]
        problems += [
            f"{name}: expected none without {of}" for name, of in NEEDED.items() if name in given and of not in given
        ]
        if self.frames > 1 and self.views_per_scene > 1:
            problems.append("views_per_scene: expected none beside frames of 2 or more")
        if "fps" in given and self.frames == 1:
            problems.append("fps: expected none without frames of 2 or more")
        if "address" in given and self.executor != "ray":
            problems.append("address: expected none without executor ray")
        problems += self._idle_changes()
        if problems:
            raise ValueError("\n".join(problems))
        return self

    def _idle_changes(self) -> list[str]:
        """A line for each changed parameter that has no effect beside the other fields."""
        if self.set and isinstance(self.params, Params):
            return ["set: expected none beside parameters that are loaded already"]
        both, keys = (*self.set, *self.spreads), [_key(change) for change in self.set]
        idle = [
            (self.set, KEYS_OF_ROADS, "with map, which has roads of its own" if self.map else ""),
            (both, KEYS_OF_CAMERA_FILES, "with camera, whose file has it" if self.camera else ""),
            (both, KEYS_OF_CAMERA_FILES, "with rig, whose file has it" if self.rig else ""),
            (both, ("motion.",), "without frames of 2 or more" if self.frames == 1 else ""),
            (both, ("sensor.jpeg_quality",), "with image_format png" if self.image_format == "png" else ""),
        ]
        lines = [
            f"set {key}: expected one value, got {keys.count(key)}"
            for key in dict.fromkeys(keys)
            if keys.count(key) > 1
        ]
        for changes, known, why in idle:
            found = [change for change in changes if why and _is_one_of(_key(change), known)]
            lines += [f"{', '.join(found)}: no effect {why}"] if found else []
        return lines

    @property
    def asked(self) -> dict[str, int]:
        """The splits with their numbers of samples. Raises InputError if there are none."""
        if self.splits:
            return dict(self.splits)
        if self.n is None:
            raise InputError("n: expected the number of samples, got none")
        return {self.split: self.n}

    @property
    def settings(self) -> RenderSettings:
        passes = (*self.passes, *(["lidar"] if self.lidar is not None else []))
        return RenderSettings(self.samples or QUALITY_SAMPLES[self.quality], passes, self.device)

    @property
    def lidar_spec(self) -> LidarSpec | None:
        """The lidar, read from its file. Raises InputError with a line for each problem."""
        return load_lidar(self.lidar) if isinstance(self.lidar, str) else self.lidar

    def library(self, warn: Callable[[str], None] = lambda line: None) -> Library:
        """The assets, checked if they are in a folder; `warn` is called with a line for each file that is unusual."""
        if not isinstance(self.assets, str):
            return self.assets or BUILT_IN
        library, warnings = open_library(Path(self.assets))
        for line in warnings:
            warn(f"assets {self.assets}: {line}")
        return library

    def recipe(self, warn: Callable[[str], None] = lambda line: None) -> Recipe:
        """All that decides the bytes of the first split's samples, read from the files that are named. `warn` is called
        with a line for what is usable but does not fit together.

        Raises InputError or FormatError with a line for each problem.
        """
        library, shots = self.library(warn), self._shots()
        params = self.params if isinstance(self.params, Params) else load_params(self.params, self.set, library.assets)
        _require_use(self.set, params)
        for line in () if params is self.params else contradictions(params):
            warn(line)
        scenes = Scenes(
            params,
            self.seed,
            next(iter(self.splits), self.split),
            assets=library.assets,
            shots=shots,
            like=self._like(params, library, bool(shots.cameras)),
            map=self._place(),
        )
        condition = Condition(self.where, self.tries) if self.where else None
        return Recipe(scenes, self.settings, self.image_format, library, where=condition)

    def plans(self, warn: Callable[[str], None] = lambda line: None) -> list[Plan]:
        """A plan for each split; `warn` is also called now and then while no scene that fits `where` is found. Raises
        as `recipe` does, and if none fits."""
        asked, out = self.asked, self.out
        if out is None:
            raise InputError("out: expected a folder or a URL, got none")
        recipe = self.recipe(warn)
        plans = []
        for split, n in asked.items():
            of_split = replace(recipe, scenes=replace(recipe.scenes, split=split))
            if of_split.where is not None:
                fitting_world(of_split.scenes, of_split.where, 0, warn)
            plans.append(Plan(out, n, of_split, self.workers, self.part))
        return plans

    def text(self, recipe: Recipe, tell: Callable[[str], None] = lambda line: None) -> str:
        """What the scenes of a recipe of this job are drawn from, in words. `tell` is called as by `plans`."""
        changes = f" with {', '.join(self.set)}" if self.set else ""
        return ", ".join(
            filter(
                None,
                [
                    f"parameters {_named(self.params)}{changes}",
                    recipe.scenes.like.text() if recipe.scenes.like else "",
                    recipe.scenes.map.map.text() if recipe.scenes.map else "",
                    recipe.where.probe(recipe.scenes, tell) if recipe.where else "",
                    f"camera {_named(self.camera)}" if self.camera else "",
                    f"rig {_named(self.rig)}" if self.rig else "",
                ],
            )
        )

    def changed(self, fields: Mapping[str, Any]) -> "Job":
        """The job with these fields changed, and without the fields that they exclude."""
        excluded = {name for pair in EXCLUSIVE for name in pair if set(pair) & fields.keys()} - fields.keys()
        kept = {name: getattr(self, name) for name in self.model_fields_set - excluded}
        return Job(**{**kept, **fields})

    def document(self) -> dict[str, Any]:
        """The fields that were given, as plain values of YAML."""
        return {name: _plain(getattr(self, name)) for name in type(self).model_fields if name in self.model_fields_set}

    def _shots(self) -> Shots:
        rig = load_rig(self.rig) if isinstance(self.rig, str) else self.rig
        camera = load_camera(self.camera) if isinstance(self.camera, str) else self.camera
        shots = clips(self.frames, self.fps, rig if camera is None else (camera,), self.views_per_scene)
        return shots.model_copy(update={"lidar": self.lidar_spec})

    def _like(self, params: Params, library: Library, own_camera: bool) -> Neighbourhood | None:
        if not self.like:
            return None
        if isinstance(self.like, str):
            given = given_scenes(Path(self.like), params, library.assets, own_camera)
        else:
            scenes = [scene for scene in self.like if isinstance(scene, Scene)]
            keys = tuple(key for key in self.like if not isinstance(key, Scene))
            given = (*keys, *(drawn(scenes, params, library.assets, "like", own_camera) if scenes else ()))
        return read_like(given, self.spreads)

    def _place(self) -> MapPlace | None:
        return place_on_map(Path(self.map), self.at) if self.map else None


def load_job(
    path: Path, changes: Mapping[str, Any] | None = None, warn: Callable[[str], None] = lambda line: None
) -> Job:
    """Read the job of a YAML file or of a `dataset.json`, with some fields changed. Paths in it are relative to its
    folder. `warn` is called with a line where another version made the data set.

    Raises InputError or FormatError with a line for each problem, beginning with the path.
    """
    text = text_of(path, str(path))
    document, problems = read_yaml(text, str(path))
    if problems or not isinstance(document, dict):
        raise InputError(*(problems or [f"{path}: expected the fields of a job such as n, got {shown(document)}"]))
    try:
        if document.get("format") == DATASET_FORMAT:
            job = job_of_description(parse_description(text.encode(), str(path)))
            if (version := document.get("generator")) != __version__:
                warn(f"{path}: made by version {version}; version {__version__} may give other pictures and labels")
        else:
            job = Job(**document)
        here = _moved({name: getattr(job, name) for name in job.model_fields_set}, partial(_beside, path))
        return Job(**here).changed(changes or {})
    except InputError as error:
        raise InputError(*(f"{path}: {problem}" for problem in error.problems)) from None


def save_job(job: Job, path: Path) -> None:
    """Write a job as YAML that `load_job` reads back; paths are relative to the folder of the file."""
    document = _moved(job.document(), lambda name: os.path.relpath(name, path.parent))
    write(path, to_yaml(document).encode())


def job_of_description(description: Mapping[str, Any]) -> Job:
    """The job that makes a data set with the contents of its `dataset.json`, but for a folder of assets. Raises
    InputError for samples that were derived from others, FormatError for what cannot be read."""
    if description.get("derived") is not None:
        raise InputError("expected a data set that generate made, got one derived from other data")
    made = read_provenance(description, DESCRIPTION)
    like, given = made.like, made.map
    scenes = {
        **({"like": like.scenes, "spreads": like.texts()} if like else {}),
        **({"map": given.file} if given else {}),
        **({"at": given.at.text()} if given and given.at else {}),
        **({"where": made.where} if made.where else {}),
    }
    splits = {name: split["n"] for name, split in description["splits"].items()}
    return Job(splits=splits, **scenes, **pictures_of(made))


def pictures_of(made: Provenance) -> dict[str, Any]:
    """The fields of a job that makes pictures like a data set's."""
    shots, render = made.shots, made.render
    return {
        "seed": made.seed,
        "params": made.params,
        "image_format": made.image_format,
        "samples": render.samples,
        "passes": [name for name in render.passes if name != "lidar"],
        "device": render.device,
        "rig": shots.cameras,
        "lidar": shots.lidar,
        **({"frames": shots.frames, "fps": shots.fps} if shots.frames > 1 else {}),
        **({"views_per_scene": shots.views} if shots.views > 1 else {}),
    }


def make(
    job: Job, notify: Callable[[Event], None] = lambda event: None, warn: Callable[[str], None] = lambda line: None
) -> RunReport:
    """Make the splits of a job in order, until one cannot be finished. The report covers all of them."""
    reports: list[RunReport] = []
    for plan in job.plans(warn):
        reports.append(generate(plan, notify, job.executor, job.address))
        if reports[-1].exit_code:
            break
    return total(reports)


def _lines(problem: ErrorDetails) -> list[str]:
    """A line for a problem of a field; for a rule about several fields, a line for each of them."""
    steps = problem["loc"]
    problem["loc"] = (*steps[:1], *(step for step in steps[1:] if step not in TAGS))
    if problem["type"] == "extra_forbidden" and len(steps) == 1:
        return [f"{steps[0]}: {unknown_key(str(steps[0]), Job.model_fields)}"]
    return problem_line(problem).splitlines()


def _key(change: str) -> str:
    return change.partition("=")[0].strip()


def _require_use(changes: Sequence[str], params: Params) -> None:
    """Raise InputError with a line for each changed parameter of a group that no scene uses."""
    idle = params.idle()
    groups = {change: _key(change).partition(".")[0] for change in changes if _key(change) not in SWITCHES}
    if lines := [f"{change}: no effect, {idle[group]}" for change, group in groups.items() if group in idle]:
        raise InputError(*lines)


def _is_one_of(key: str, known: Sequence[str]) -> bool:
    """Whether a parameter is one of these, or of one of the groups among them, which end in a point."""
    return key in known or key.startswith(tuple(name for name in known if name.endswith(".")))


def _named(value: Any) -> str:
    return value if isinstance(value, str) else "of its own"


def _plain(value: Any) -> Any:
    """A field's value as one of YAML: of a scene, what it was drawn for; of assets, their folder."""
    if isinstance(value, Scene):
        return [value.seed, value.split, value.index]
    if isinstance(value, Library):
        return value.folder
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json")
    if isinstance(value, dict):
        return {key: _plain(each) for key, each in value.items()}
    return [_plain(each) for each in value] if isinstance(value, list | tuple) else value


def _beside(path: Path, name: str) -> str:
    return os.path.normpath(path.parent / name)


def _moved(document: Mapping[str, Any], to: Callable[[str], str]) -> dict[str, Any]:
    """The fields of a job with each relative path changed; names of built-in things, and URLs, stay."""
    moved = dict(document)
    for name in (*FILES, *NAMES):
        value = moved.get(name)
        if isinstance(value, str) and (name in FILES or value.endswith((".yaml", ".yml"))):
            moved[name] = value if os.path.isabs(value) or "://" in value else to(value)
    if isinstance(params := moved.get("params"), dict) and str(params.get(BASE, "")).endswith((".yaml", ".yml")):
        moved["params"] = {**params, BASE: to(params[BASE])}
    return moved
