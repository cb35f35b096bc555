"""The scenes of `generate --like FILE`, which new scenes are drawn near: scenes as JSON, names of samples, or the worst
samples of an evaluation."""

import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from synth3dlanes.dataset.address import SAMPLE
from synth3dlanes.dataset.read import Reader
from synth3dlanes.dataset.scenes import read_scene
from synth3dlanes.draw.like import MAX_SCENES, DrawKey
from synth3dlanes.draw.sample import Scenes, sample_scene
from synth3dlanes.params.params import Params
from synth3dlanes.params.shots import ShotNumbers, clips
from synth3dlanes.scene.assets.catalogue import Assets
from synth3dlanes.scene.scene import Scene, from_json
from synth3dlanes.system.errors import FormatError, InputError
from synth3dlanes.system.files import read_bounded
from synth3dlanes.system.schema import Excerpt, parse

# Room for 100,000 scenes of 5 kB.
MAX_FILE_BYTES = 512 << 20
# The worst 1 / WORST of the samples of an evaluation is used.
WORST = 10
# The number of scenes that are drawn again to check that they fit the parameters.
CHECKED = 5


class EvaluatedSample(Excerpt):
    """One sample in a stored evaluation."""

    key: Annotated[str, Field(pattern=r"^\d{8}$")]


class StoredEvaluation(Excerpt):
    """The part of the result of `evaluate --json` on a split of ours that names its samples, the worst first."""

    source: Annotated[str, Field(max_length=1000)]
    samples: Annotated[tuple[EvaluatedSample, ...], Field(min_length=1)]


def given_scenes(path: Path, params: Params, assets: Assets, own_camera: bool = False) -> tuple[DrawKey, ...]:
    """The draws of the scenes in a file: either one scene per line, as scene.json or as a sample such as
    DIR/test:00000017; or a result of `evaluate --json`, whose worst tenth is used.

    Raises InputError or FormatError with a line for each problem, also for a scene that other parameters draw.
    """
    try:
        text = read_bounded(path, MAX_FILE_BYTES).decode()
    except FormatError as error:
        raise InputError(f"like {error}") from None
    except (OSError, ValueError) as error:
        raise InputError(f"like {path}: cannot read: {getattr(error, 'strerror', None) or error}") from None
    return drawn(_scenes(text, f"like {path}"), params, assets, f"like {path}", own_camera)


def drawn(
    scenes: Iterable[Scene], params: Params, assets: Assets, where: str, own_camera: bool = False
) -> tuple[DrawKey, ...]:
    """The draws of scenes, each once. Raises InputError if there are none, and for a scene that these parameters do not
    draw. With a camera of the user's own, the parameters' camera is not compared."""
    found: dict[DrawKey, None] = {}
    for scene in scenes:
        if len(found) < CHECKED:
            _check(scene, params, assets, where, own_camera)
        found[scene.seed, scene.split, scene.index] = None
    if not 0 < len(found) <= MAX_SCENES:
        raise InputError(f"{where}: expected 1 to {MAX_SCENES} scenes, got {len(found)}")
    return tuple(found)


def _scenes(text: str, where: str) -> Iterator[Scene]:
    scores = _scores(text, where)
    lines = text.splitlines() if scores is None else _worst(scores)
    opened = dict[str, Reader]()
    for number, line in enumerate(lines, start=1):
        if SAMPLE.fullmatch(line.strip()):
            try:
                url, _, key = line.strip().rpartition(":")
                if url not in opened:
                    opened[url] = Reader(url)
                scene = read_scene(opened[url], opened[url].position(key))
            except (FormatError, InputError) as error:
                raise InputError(*(f"{where}: {problem}" for problem in str(error).splitlines())) from None
            yield scene
        elif line.strip():
            yield from_json(line, f"{where}: line {number}")


def _scores(text: str, where: str) -> StoredEvaluation | None:
    """The result of an evaluation, None for another file."""
    try:
        document: Any = json.loads(text)
    except (ValueError, RecursionError):
        return None
    if not isinstance(document, dict) or "samples" not in document:
        return None
    return parse(StoredEvaluation, text, where, "a result of evaluate --json on a data set of synth3dlanes")


def _worst(scores: StoredEvaluation) -> list[str]:
    return [f"{scores.source}:{sample.key}" for sample in scores.samples[: -(-len(scores.samples) // WORST)]]


def _check(scene: Scene, params: Params, assets: Assets, where: str, own_camera: bool) -> None:
    """Raise InputError unless these parameters draw the scene, in pictures such as its own."""
    shots = clips(scene.shot.n_frames, scene.shot.fps, views=scene.shot.n_views)
    index = shots.index(ShotNumbers(scene.index, scene.shot.frame, 0, scene.shot.view))
    again = sample_scene(Scenes(params, scene.seed, scene.split, assets=assets, shots=shots), index)
    # Lidars and rigs are no parameters.
    kept = {name: getattr(scene.shot, name) for name in ("camera", "n_cameras", "behind_m")}
    again = again.model_copy(update={"lidar": scene.lidar, "shot": again.shot.model_copy(update=kept)})
    if own_camera:
        place = {name: getattr(again.camera, name) for name in ("lane", "y_m", "offset_m")}
        again = again.model_copy(update={"camera": scene.camera.model_copy(update=place)})
    wrong = [name for name in Scene.model_fields if getattr(again, name) != getattr(scene, name)]
    if wrong:
        raise InputError(
            f"{where}: expected scenes as these parameters draw them, got other {', '.join(wrong)} in scene "
            f"{scene.index} of {scene.split}, seed {scene.seed}; use the --params, --set, --camera and --assets of its "
            "data set"
        )
