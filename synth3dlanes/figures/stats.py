"""Statistics of scenes and labels: whether each parameter follows its declared distribution, and label quantities;
histograms of both, as counts in bins, with the counts that are expected as declared."""

import dataclasses
import math
import re
from collections import Counter, defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import stats

from synth3dlanes.draw.rules import CONDITIONED, ParameterRules
from synth3dlanes.figures.describe import bends, grades
from synth3dlanes.labels.labels import Labels
from synth3dlanes.params.distributions import Choice, Distribution, Integers, Uniform
from synth3dlanes.params.groups import NO_JUNCTION, OPTIONAL
from synth3dlanes.params.params import Params
from synth3dlanes.scene.scene import Scene
from synth3dlanes.scene.town import Town
from synth3dlanes.system.arrays import Scalars
from synth3dlanes.world.camera import horizontal_fov_rad

# The distributions of a parameter by the rules, with the number of values drawn from each.
Cases = tuple[tuple[Distribution, int], ...]

DOUBTFUL_P = 1e-4
"""With about 50 parameters, a p value below this is unlikely to be chance."""

_ROUNDING = 1e-4
"""Scenes hold radians rounded to 1e-6; this is an upper bound of the error in degrees."""


@dataclass(frozen=True)
class ParameterStatistics:
    """One parameter: its declared distribution, its drawn values, and how well they agree. `test` is "KS" (continuous),
    "chi2" (discrete), "equal" (constant), or the reason why there is no test. If the rules give the parameter several
    distributions, `low` and `high` cover all of them; the test with the least p value is reported, its p value
    multiplied by the number of tests."""

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
class QuantitySummary:
    """The range, mean and percentiles of one quantity of labels."""

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
    """Statistics of scenes. For plots, `drawn` keeps the values in the declared units, and `declared` their
    distributions."""

    n_scenes: int
    parameters: tuple[ParameterStatistics, ...]
    topologies: dict[str, int]
    drawn: dict[str, Scalars]
    declared: dict[str, Cases]


# The statistics of samples without scenes, lifted from a real drive.
NO_SCENES = SceneStatistics(0, (), {}, {}, {})


@dataclass(frozen=True, eq=False)
class LabelStatistics:
    """Statistics of labels; `measured` keeps the values for plots."""

    n_images: int
    summaries: tuple[QuantitySummary, ...]
    measured: dict[str, Scalars]


@dataclass(frozen=True, eq=False)
class Statistics:
    """Statistics of scenes and, if these were rendered, of their labels."""

    scenes: SceneStatistics
    labels: LabelStatistics | None = None

    def document(self) -> dict[str, Any]:
        """The statistics, without the values behind them, for JSON."""
        found: dict[str, Any] = {
            "n_scenes": self.scenes.n_scenes,
            "topologies": self.scenes.topologies,
            "parameters": [dataclasses.asdict(parameter) for parameter in self.scenes.parameters],
        }
        if self.labels is not None:
            found["labels"] = [dataclasses.asdict(summary) for summary in self.labels.summaries]
        return found


def scene_statistics(scenes: Iterable[Scene], params: Params, own_camera: bool = False) -> SceneStatistics:
    """Compare every parameter that scenes hold with the distributions that the rules (`draw.rules`) give it. With a
    user's own camera, of the camera's parameters only the host's place is compared. A name counts as its place in the
    list. Keeps all drawn values."""
    rules = ParameterRules(params)
    topologies: Counter[str] = Counter()
    drawn: dict[str, dict[Distribution | None, list[float]]] = defaultdict(lambda: defaultdict(list))
    for scene in scenes:
        topologies[scene.roads.words] += 1
        of_scene = rules.of(scene)
        for key, values in drawn_values(scene, params).items():
            if key in of_scene:
                drawn[key][of_scene[key]].extend(values)
    declared = {
        f"{name}.{key}": distribution
        for name, group in params.groups.items()
        for key, distribution in group
        if not (own_camera and _is_of_camera(f"{name}.{key}"))
        and (f"{name}.{key}" in drawn or not (_is_named(distribution) or name in OPTIONAL))
    }
    by_case = {
        key: [(case, np.array(values, dtype=float)) for case, values in drawn[key].items() if values]
        for key in declared
    }
    return SceneStatistics(
        sum(topologies.values()),
        tuple(_parameter(key, distribution, by_case[key]) for key, distribution in declared.items()),
        dict(sorted(topologies.items())),
        {key: np.concatenate([np.zeros(0), *(values for _, values in cases)]) for key, cases in by_case.items()},
        {
            key: tuple((case or distribution, len(values)) for case, values in by_case[key])
            for key, distribution in declared.items()
        },
    )


def _is_of_camera(key: str) -> bool:
    return key.startswith("camera.") and key not in ("camera.lane", "camera.y_m", "camera.offset_m")


def is_fine(parameter: ParameterStatistics) -> bool:
    """Whether every value lies in the declared range and the test does not reject the declared distribution."""
    return parameter.outside == 0 and (parameter.p_value is None or parameter.p_value >= DOUBTFUL_P)


def drawn_values(scene: Scene, params: Params) -> dict[str, list[float]]:
    """All values of each parameter in a scene, in the parameter's unit, by its key. A name counts as its place in the
    declared list."""
    values: dict[str, list[float]] = {}
    for group in ("road", "markings", "surface", "camera", "light", "air", "sensor", "weather", "host", "vegetation"):
        values |= {
            _key(group, field): [_declared_unit(field, value)]
            for field, value in getattr(scene, group) or ()
            if isinstance(value, int | float)
        }
    if scene.town is not None:
        values |= _town_values(scene.town, params)
    elif not scene.roads.source and params.is_town and NO_JUNCTION in params.town.junction.values:
        values["town.junction"] = [params.town.junction.values.index(NO_JUNCTION)]
    values["camera.horizontal_fov_deg"] = [math.degrees(horizontal_fov_rad(scene.camera))]
    offsets_px = scene.camera.cx_px - scene.camera.width_px / 2, scene.camera.cy_px - scene.camera.height_px / 2
    values["camera.principal_offset_px"] = list(offsets_px)
    values["terrain.n_gaussians"] = [len(scene.terrain.gaussians)]
    values["cars.n"], values["trees.n"] = [len(scene.cars)], [len(scene.trees)]
    for name in ("kind", "daytime"):
        names = getattr(params.weather, name).values
        if len(names) > 1 and getattr(scene.weather, name) in names:
            values[f"weather.{name}"] = [names.index(getattr(scene.weather, name))]
    for group, parts in (("terrain", scene.terrain.gaussians), ("cars", scene.cars), ("trees", scene.trees)):
        for part in parts:
            for field, value in part:
                several = value if isinstance(value, tuple) else (value,)
                numbers = [_declared_unit(field, one) for one in several if isinstance(one, int | float)]
                if numbers:
                    values.setdefault(_key(group, field), []).extend(numbers)
    return values


def _town_values(town: Town, params: Params) -> dict[str, list[float]]:
    values: dict[str, list[float]] = {}
    for field, value in town:
        if isinstance(value, str):
            names = getattr(params.town, field).values
            values |= {f"town.{field}": [names.index(value)]} if len(names) > 1 and value in names else {}
        elif isinstance(value, tuple):
            values["town.bend_deg"] = [math.degrees(bend) for bend in value]
        else:
            values[_key("town", field)] = [_declared_unit(field, value)]
    return values


def label_statistics(labels: Iterable[Labels]) -> LabelStatistics:
    """Grade, curvature, visibility and number of lanes over all images."""
    collected: dict[str, list[Scalars]] = defaultdict(list)
    n_images = 0
    for one in labels:
        n_images += 1
        for name, values in _measure(one).items():
            collected[name].append(values)
    measured = {name: np.concatenate(values) for name, values in collected.items()}
    return LabelStatistics(n_images, tuple(_summary(name, values) for name, values in measured.items()), measured)


def form(distribution: Distribution) -> str:
    """A distribution as parameter files write it."""
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


def _parameter(
    key: str, declared: Distribution, by_case: list[tuple[Distribution | None, Scalars]]
) -> ParameterStatistics:
    if not by_case:
        low, high = _limits(declared)
        return ParameterStatistics(key, form(declared), low, high, 0, 0.0, 0.0, 0.0, 0, "none drawn", None, None)
    limits = [_limits(case or declared) for case, _ in by_case]
    outside = sum(
        int(((values < low - _ROUNDING) | (values > high + _ROUNDING)).sum())
        for (low, high), (_, values) in zip(limits, by_case, strict=True)
    )
    tests = [_agreement(case, values) for case, values in by_case if case is not None]
    least = min(tests, key=lambda found: found.p_value, default=Agreement(CONDITIONED.get(key, "cut to the road")))
    p_value = None if not tests else min(1.0, least.p_value * len(tests))
    values = np.concatenate([values for _, values in by_case])
    return ParameterStatistics(
        key,
        form(declared),
        min(low for low, _ in limits),
        max(high for _, high in limits),
        values.size,
        *(float(values.min()), float(values.max()), float(values.mean())),
        outside,
        least.test,
        least.statistic,
        p_value,
    )


def _is_named(distribution: Distribution) -> bool:
    """Whether the parameter is one of several names, and so has no range."""
    return isinstance(distribution, Choice) and isinstance(distribution.values[0], str)


def _limits(distribution: Distribution) -> tuple[float, float]:
    if isinstance(distribution, Choice):
        values = numbers(distribution)
        return float(values.min()), float(values.max())
    return float(distribution.low), float(distribution.high)


def numbers(choice: Choice[Any]) -> Scalars:
    """The values of a choice as numbers; a name counts as its place in the list."""
    is_named = _is_named(choice)
    return np.array([i if is_named else value for i, value in enumerate(choice.values)], dtype=float)


class Agreement(NamedTuple):
    """How a test judges the hypothesis that values were drawn from a distribution."""

    test: str
    statistic: float | None = None
    p_value: float = 1.0


def _agreement(distribution: Distribution, values: Scalars) -> Agreement:
    if isinstance(distribution, Uniform) and distribution.high > distribution.low:
        result = stats.kstest(values, stats.uniform(distribution.low, distribution.high - distribution.low).cdf)
        return Agreement("KS", float(result.statistic), float(result.pvalue))
    if isinstance(distribution, Choice):
        allowed, which = np.unique(numbers(distribution), return_inverse=True)
        shares = np.bincount(which, distribution.weights) / sum(distribution.weights)
    else:
        allowed = np.arange(distribution.low, distribution.high + 1, dtype=float)
        shares = np.full(len(allowed), 1 / len(allowed))
    is_each = np.abs(values[:, None] - allowed) <= _ROUNDING
    if len(allowed) == 1 or not is_each.any(axis=1).all():
        return Agreement("equal", float((~is_each.any(axis=1)).sum()), float(is_each.any(axis=1).all()))
    counts = stats.chisquare(is_each.sum(axis=0), len(values) * shares)
    return Agreement("chi2", float(counts.statistic), float(counts.pvalue))


def _measure(labels: Labels) -> dict[str, Scalars]:
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
    if labels.traffic_elements:
        shown = [item for item in labels.traffic_elements if item.box_px is not None]
        measured["traffic elements an image"] = np.array([len(shown)], dtype=float)
        heights_px = [item.box_px[3] - item.box_px[1] for item in shown if item.box_px is not None]
        measured["height of a traffic element [px]"] = np.array(heights_px, dtype=float)
    if in_image.any():
        measured["points over the ground [%]"] = np.array([100 * over_ground.mean()])
        if all(lane.object_visible is not None for lane in labels.lanes):
            measured["points seen in the end [%]"] = np.array([100 * visible.mean()])
    return measured


def _summary(name: str, values: Scalars) -> QuantitySummary:
    if not values.size:
        return QuantitySummary(name, 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    low, p05, median, p95, high = np.percentile(values, [0, 5, 50, 95, 100]).tolist()
    return QuantitySummary(name, values.size, low, p05, median, p95, high, float(values.mean()))


_UNITS = {"m": "m", "deg": "°", "px": "px"}
# Greatest number of values of a discrete parameter that get a bin each.
_MAX_SINGLE_BINS = 30


@dataclass(frozen=True, eq=False)
class Histogram:
    """Counts of one quantity between `edges`.

    `quantity` names the horizontal axis with its unit. `expected` is the count in each bin by the declared
    distribution, None for label quantities; `is_fine` is false for a parameter that is not as declared.
    """

    title: str
    quantity: str
    edges: Float[np.ndarray, " e"]
    counts: Float[np.ndarray, " n"]
    expected: Float[np.ndarray, " n"] | None
    is_fine: bool

    @property
    def is_of_integers(self) -> bool:
        """Whether each bin is for one integer."""
        return bool((self.edges % 1 == 0.5).all())


def histograms(scenes: SceneStatistics, labels: LabelStatistics | None) -> list[Histogram]:
    """One histogram for each label quantity and for each parameter that varies."""
    measured = {} if labels is None else labels.measured
    varying = [row for row in scenes.parameters if row.count and row.minimum < row.maximum]
    return [
        *(_of_labels(name, values) for name, values in measured.items() if values.size),
        *(_of_parameter(row, scenes.declared[row.key], scenes.drawn[row.key]) for row in varying),
    ]


def _of_labels(name: str, values: Scalars) -> Histogram:
    # With few values, the quantiles are the first and the last.
    low, high = np.percentile(values, [0.5, 99.5], method="closest_observation")
    is_whole = bool((values % 1 == 0).all()) and high - low < _MAX_SINGLE_BINS
    edges = _single_bins(low, high) if is_whole else np.linspace(low, max(high, low + 1e-6), 41)
    return Histogram(name.partition(" [")[0], name, edges, np.histogram(values, edges)[0].astype(float), None, True)


def _of_parameter(row: ParameterStatistics, declared: Cases, values: Scalars) -> Histogram:
    edges = _edges(row, declared)
    _, _, key = row.key.partition(".")
    name, unit = re.fullmatch(r"(.*?)(?:_(m|deg|px))?", key).groups()  # type: ignore[union-attr]
    quantity = name.replace("_", " ") + (f" [{_UNITS[unit]}]" if unit else "")
    title = f"{row.key} ({CONDITIONED[row.key]})" if row.key in CONDITIONED else row.key
    return Histogram(
        title,
        quantity,
        edges,
        np.histogram(values, edges)[0].astype(float),
        np.sum([count * declared_shares(case, edges) for case, count in declared], axis=0),
        is_fine(row),
    )


def _edges(row: ParameterStatistics, declared: Cases) -> Float[np.ndarray, " e"]:
    """Bins over the declared range and all values; one for each value of a discrete parameter with few values."""
    low, high = min(row.low, row.minimum), max(row.high, row.maximum)
    if all(_is_whole(case) for case, _ in declared) and high - low < _MAX_SINGLE_BINS:
        return _single_bins(low, high)
    return np.linspace(low, high, 21)


def _is_whole(declared: Distribution) -> bool:
    if isinstance(declared, Choice):
        return all(isinstance(value, str) or float(value).is_integer() for value in declared.values)
    return isinstance(declared, Integers)


def _single_bins(low: float, high: float) -> Float[np.ndarray, " e"]:
    """Edges of a bin for each integer."""
    return np.arange(math.floor(low) - 0.5, math.ceil(high) + 1)


def declared_shares(declared: Distribution, edges: Float[np.ndarray, " e"]) -> Scalars:
    """The probability of each bin."""
    if isinstance(declared, Uniform) and declared.high > declared.low:
        return np.diff(np.clip((edges - declared.low) / (declared.high - declared.low), 0.0, 1.0))
    if isinstance(declared, Choice):
        values, weights = numbers(declared), np.array(declared.weights)
    else:
        values = np.arange(declared.low, declared.high + 1, dtype=float)
        weights = np.ones(len(values))
    return np.asarray(np.histogram(values, edges, weights=weights / weights.sum())[0])
