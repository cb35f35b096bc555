"""Statistics of scenes and labels: whether each parameter follows its declared distribution, and label quantities."""

import dataclasses
import json
import math
from collections import Counter, defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy import stats

from synth3dlanes.distributions import Choice, Integers, Uniform
from synth3dlanes.figures.describe import topology_words
from synth3dlanes.figures.shape import bends, grades
from synth3dlanes.geometry.camera import horizontal_fov_rad
from synth3dlanes.labels import Labels
from synth3dlanes.params import OPTIONAL, Params
from synth3dlanes.sampling.weather import replaced
from synth3dlanes.scene import Scene

Values = Float[np.ndarray, " n"]
Distribution = Uniform | Integers | Choice[Any]

CONDITIONED = {
    "camera.lane": "cut to the road",
    "cars.s_m": "kept apart",
    "trees.x_m": "kept off roads",
    "trees.y_m": "kept off roads",
}
"""Parameters whose drawn values need to keep the declared range but not the distribution, with the reason."""

DOUBTFUL_P = 1e-4
"""With about 50 parameters, a p value below this is unlikely to be chance."""

_ROUNDING = 1e-4
"""Scenes hold radians rounded to 1e-6; this is an upper bound of the error in degrees."""


@dataclass(frozen=True)
class ParameterStatistics:
    """One parameter: what was declared, what was drawn, and how well they agree.

    `test` is "KS" (continuous), "chi2" (discrete), "equal" (constant) or the reason why there is none.
    """

    key: str
    declared: str
    low: float
    high: float
    count: int
    minimum: float
    maximum: float
    mean: float
    outside: int
    test: str
    statistic: float | None
    p_value: float | None


@dataclass(frozen=True)
class Summary:
    """A measured quantity of labels: its range, mean and percentiles."""

    name: str
    count: int
    minimum: float
    p05: float
    median: float
    p95: float
    maximum: float
    mean: float


@dataclass(frozen=True, eq=False)
class SceneStatistics:
    """Statistics of scenes; `drawn` keeps the values in the declared units, and `declared` the distributions, for
    plots."""

    n_scenes: int
    parameters: tuple[ParameterStatistics, ...]
    topologies: dict[str, int]
    drawn: dict[str, Values]
    declared: dict[str, Distribution]


@dataclass(frozen=True, eq=False)
class LabelStatistics:
    """Statistics of labels; `measured` keeps the values for plots."""

    n_images: int
    summaries: tuple[Summary, ...]
    measured: dict[str, Values]


def scene_statistics(scenes: Iterable[Scene], params: Params, own_camera: bool = False) -> SceneStatistics:
    """Compare every parameter that is a number and that scenes hold with its declared distribution, in the scenes
    whose weather does not replace it; with a user's own camera, those of the host's place alone. Keeps all drawn
    values: about 15 kB per scene."""
    collected: dict[str, list[Values]] = defaultdict(list)
    topologies: Counter[str] = Counter()
    n_scenes = 0
    for scene in scenes:
        n_scenes += 1
        topologies[topology_words(scene.road)] += 1
        drawn_otherwise = replaced(scene.weather.kind, scene.weather.daytime)
        for key, values in drawn_values(scene).items():
            if key in drawn_otherwise or (own_camera and _is_of_camera(key)):
                continue
            collected[key].append(np.array(values, dtype=float))
    drawn = {key: np.concatenate(values) for key, values in collected.items()}
    if "sold" in params.cars.palette.values:
        drawn = {key: values for key, values in drawn.items() if key not in ("cars.color", "cars.saturation")}
    declared = {
        f"{name}.{key}": distribution
        for name, group in params
        for key, distribution in group
        if not (own_camera and _is_of_camera(f"{name}.{key}"))
        and not _is_named(distribution)
        and (name not in OPTIONAL or f"{name}.{key}" in drawn)
    }
    parameters = tuple(
        _parameter(key, distribution, drawn.get(key, np.zeros(0))) for key, distribution in declared.items()
    )
    return SceneStatistics(n_scenes, parameters, dict(sorted(topologies.items())), drawn, declared)


def _is_of_camera(key: str) -> bool:
    return key.startswith("camera.") and key not in ("camera.lane", "camera.y_m", "camera.offset_m")


def is_fine(parameter: ParameterStatistics) -> bool:
    """Whether every value lies in the declared range and the test does not reject the declared distribution."""
    return parameter.outside == 0 and (parameter.p_value is None or parameter.p_value >= DOUBTFUL_P)


def drawn_values(scene: Scene) -> dict[str, list[float]]:
    """All values of each parameter in a scene, by the parameter's key and in its units."""
    values: dict[str, list[float]] = {}
    for group in ("road", "markings", "surface", "camera", "light", "air", "sensor", "weather", "host", "vegetation"):
        part = getattr(scene, group)
        values |= {
            _key(group, field): [_declared_unit(field, value)]
            for field, value in part
            if isinstance(value, int | float)
        }
    values["camera.horizontal_fov_deg"] = [math.degrees(horizontal_fov_rad(scene.camera))]
    offsets_px = scene.camera.cx_px - scene.camera.width_px / 2, scene.camera.cy_px - scene.camera.height_px / 2
    values["camera.principal_offset_px"] = list(offsets_px)
    values["terrain.n_gaussians"] = [len(scene.terrain.gaussians)]
    values["cars.n"], values["trees.n"] = [len(scene.cars)], [len(scene.trees)]
    for group, parts in (("terrain", scene.terrain.gaussians), ("cars", scene.cars), ("trees", scene.trees)):
        for part in parts:
            for field, value in part:
                if isinstance(value, str):
                    continue
                several = value if isinstance(value, tuple) else (value,)
                values.setdefault(_key(group, field), []).extend(_declared_unit(field, one) for one in several)
    return values


def label_statistics(labels: Iterable[Labels]) -> LabelStatistics:
    """Grade, curvature, visibility and number of lanes over all images."""
    collected: dict[str, list[Values]] = defaultdict(list)
    n_images = 0
    for one in labels:
        n_images += 1
        for name, values in _measure(one).items():
            collected[name].append(values)
    measured = {name: np.concatenate(values) for name, values in collected.items()}
    return LabelStatistics(n_images, tuple(_summary(name, values) for name, values in measured.items()), measured)


def to_json(scenes: SceneStatistics, labels: LabelStatistics | None) -> str:
    """The statistics (without the values behind them) as one JSON document."""
    document: dict[str, Any] = {
        "n_scenes": scenes.n_scenes,
        "topologies": scenes.topologies,
        "parameters": [dataclasses.asdict(parameter) for parameter in scenes.parameters],
    }
    if labels is not None:
        document["labels"] = [dataclasses.asdict(summary) for summary in labels.summaries]
    return json.dumps(document, allow_nan=False)


def form(distribution: Distribution) -> str:
    """A distribution as it is written in parameter files."""
    if isinstance(distribution, Choice):
        if len(distribution.values) == 1:
            return str(distribution.values[0]).lower()
        pairs = zip(distribution.values, distribution.weights, strict=True)
        return "{" + ", ".join(f"{str(value).lower()}: {weight:g}" for value, weight in pairs) + "}"
    return f"[{distribution.low:g}, {distribution.high:g}]"


def _key(group: str, field: str) -> str:
    return f"{group}.{field.replace('_rad', '_deg')}"


def _declared_unit(field: str, value: float | int) -> float:
    return math.degrees(value) if field.endswith("_rad") else float(value)


def _parameter(key: str, distribution: Distribution, values: Values) -> ParameterStatistics:
    low, high = _limits(distribution)
    if not values.size:
        return ParameterStatistics(key, form(distribution), low, high, 0, 0.0, 0.0, 0.0, 0, "none drawn", None, None)
    outside = int(((values < low - _ROUNDING) | (values > high + _ROUNDING)).sum())
    test, statistic, p_value = _agreement(distribution, values)
    if key in CONDITIONED:
        test, p_value = CONDITIONED[key], None
    extent = (float(values.min()), float(values.max()), float(values.mean()))
    return ParameterStatistics(
        key, form(distribution), low, high, values.size, *extent, outside, test, statistic, p_value
    )


def _is_named(distribution: Distribution) -> bool:
    """Whether the parameter is one of several names, which have no range."""
    return isinstance(distribution, Choice) and isinstance(distribution.values[0], str)


def _limits(distribution: Distribution) -> tuple[float, float]:
    if isinstance(distribution, Choice):
        return float(min(distribution.values)), float(max(distribution.values))
    return float(distribution.low), float(distribution.high)


def _agreement(distribution: Distribution, values: Values) -> tuple[str, float | None, float | None]:
    """(test, statistic, p value) of the hypothesis that the values were drawn from the distribution."""
    if isinstance(distribution, Uniform) and distribution.high > distribution.low:
        result = stats.kstest(values, stats.uniform(distribution.low, distribution.high - distribution.low).cdf)
        return "KS", float(result.statistic), float(result.pvalue)
    if isinstance(distribution, Integers):
        allowed = np.arange(distribution.low, distribution.high + 1, dtype=float)
        weights = np.ones(len(allowed))
    elif isinstance(distribution, Choice):
        allowed, weights = np.array(distribution.values, dtype=float), np.array(distribution.weights)
    else:
        allowed, weights = np.array([distribution.low]), np.ones(1)
    is_each = np.abs(values[:, None] - allowed) <= _ROUNDING
    if len(allowed) == 1 or not is_each.any(axis=1).all():
        return "equal", float((~is_each.any(axis=1)).sum()), float(is_each.any(axis=1).all())
    counts = stats.chisquare(is_each.sum(axis=0), len(values) * weights / weights.sum())
    return "chi2", float(counts.statistic), float(counts.pvalue)


def _measure(labels: Labels) -> dict[str, Values]:
    centerlines = [lane for lane in labels.lanes if lane.kind == "centerline"]
    in_image = np.concatenate([lane.in_image for lane in labels.lanes])
    over_ground = np.concatenate([lane.terrain_visible for lane in labels.lanes])[in_image]
    visible = np.concatenate([lane.visible for lane in labels.lanes])[in_image]
    reach_m = [lane.xyz_cam[lane.visible, 1].max() for lane in centerlines if lane.visible.any()]
    measured = {
        "grade [%]": 100 * np.concatenate([grades(lane, labels) for lane in centerlines]),
        "curvature [1/km]": 1000 * np.concatenate([bends(lane, labels) for lane in centerlines]),
        "centre lines an image": np.array([sum(lane.in_image.any() for lane in centerlines)], dtype=float),
        "seen to [m]": np.array(reach_m, dtype=float),
    }
    if in_image.any():
        measured["points over the ground [%]"] = np.array([100 * over_ground.mean()])
        if all(lane.object_visible is not None for lane in labels.lanes):
            measured["points seen in the end [%]"] = np.array([100 * visible.mean()])
    return measured


def _summary(name: str, values: Values) -> Summary:
    if not values.size:
        return Summary(name, 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    low, p05, median, p95, high = np.percentile(values, [0, 5, 50, 95, 100]).tolist()
    return Summary(name, values.size, low, p05, median, p95, high, float(values.mean()))
