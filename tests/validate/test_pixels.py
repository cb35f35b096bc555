"""What is wrong with the pixels of one sample is found in that sample, and named: by line, by car, and in any case by
what is wrong. Planted in images and passes as they were rendered, which are clean."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from synth3dlanes.dataset.format import decode_image, encode_image
from synth3dlanes.draw.sample import Scenes
from synth3dlanes.labels.labels import Labels, PaintColor
from synth3dlanes.params.params import load_params
from synth3dlanes.params.rig_files import load_rig
from synth3dlanes.params.shots import Shots
from synth3dlanes.production.recipe import Recipe, make_sample
from synth3dlanes.scene.instance_ids import instance_id, numbers_of, thing_of
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.scene.things import SEMANTIC_IDS
from synth3dlanes.truth.ground_truth import ground_truth
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.validate.paint import WorldPaint
from synth3dlanes.validate.ridges import PLACES_M, LineProfiles, check_move
from synth3dlanes.world.world import resolve
from tests.scenes import changed
from tests.thorough import first
from tests.validate.examining import evidence_of, findings, reasons
from tests.validate.faults import FAULTS, aside, coarse, drawn, stretched
from tests.validate.sealing import Members, check, read_members, relabel, seal

pytestmark = pytest.mark.render

CAR, TREE, MARKING = (SEMANTIC_IDS[name] for name in ("car", "tree", "marking"))
ROAD, SHOULDER, TERRAIN = (SEMANTIC_IDS[name] for name in ("road", "shoulder", "terrain"))


def with_pass(sample: Evidence, name: str, change: Callable[[np.ndarray], np.ndarray]) -> Evidence:
    return replace(sample, passes={**sample.passes, name: change(sample.passes[name])})


def without(sample: Evidence, *names: str) -> Evidence:
    return replace(sample, passes={name: pixels for name, pixels in sample.passes.items() if name not in names})


@pytest.fixture(scope="module")
def samples(rendered: Path) -> list[Evidence]:
    return [evidence_of(members) for members in read_members(rendered).values()]


def test_clean_pixels_are_clean_whichever_passes_there_are(samples):
    names = ("depth", "normal", "semantic", "instance", "height")
    assert findings(without(samples[1], *names)) == []
    for name in names:
        assert findings(without(samples[0], name)) == []
        assert findings(without(samples[0], *(other for other in names if other != name))) == []


# Samples that once failed: worn paint under water, strong motion blur, a slit under a truck and one between two cars
# through which lines are seen, dense fog, and glare in which road and paint are white. At one sample a pixel: a gray
# trailer beside the host, a guardrail right behind a line, faint lines in low sun, glare once more, a line over the
# edge of a gore, a dam with a sunny edge of its own, a road in the blue shadow of a low sun, bare trees alone, a van
# that hides its own wheels, worn yellow paint in the shade of a kerb, worn paint on a damp road under clouds, a wet
# road that mirrors the sky, and bushes as the only leaves, once beside a truck of which a wheel is seen.
ONCE_FAILED = [*(("diverse", 2026, index, 4) for index in (175, 184, 319, 423, 558)), ("streets", 901, 95, 4)]
ONCE_FAILED += [("streets", 911, index, 1) for index in (21, 85, 239, 758, 1237, 1413)]
ONCE_FAILED += [("streets", 9200, 104, 1), ("appendix_i", 9700, 114, 1), ("streets", 9700, 30, 1)]
ONCE_FAILED += [("diverse", 9700, 26, 1), ("town", 9700, 26, 1), ("streets", 88038, 8, 1), ("mountain", 9100003, 47, 1)]
ONCE_FAILED += [("tusimple_camera", 9100009, index, 1) for index in (36, 3)]


@pytest.mark.parametrize(("preset", "seed", "index", "n_samples"), first(1, ONCE_FAILED))
def test_what_once_was_a_false_alarm_is_none(preset, seed, index, n_samples):
    settings = RenderSettings(samples=n_samples, passes=("depth", "normal", "semantic", "instance"))
    recipe = Recipe(Scenes(load_params(preset), seed, "train"), settings, "jpg")
    assert findings(evidence_of(make_sample(recipe, index).members)) == []


@pytest.mark.parametrize("index", first(1, [1807, 877]))
def test_a_pink_van_is_no_missing_texture_and_what_lies_behind_a_crest_has_no_colour(index):
    """A narrow camera behind the van, and one on a crest behind which it sees a far road; without passes."""
    recipe = Recipe(Scenes(load_params("tusimple_camera"), 911, "train"), RenderSettings(samples=1), "jpg")
    sample = evidence_of(make_sample(recipe, index).members)
    assert findings(sample, "frame", "colours") == []


def test_leaves_with_red_and_green_exchanged_are_found_by_themselves(samples):
    """Where enough of them are near and lit."""

    def exchanged(sample: Evidence) -> Evidence:
        is_tree = sample.passes["semantic"] == TREE
        return replace(sample, image=np.where(is_tree[..., None], sample.image[..., [1, 0, 2]], sample.image))

    told = [reasons(exchanged(sample), "appearance") for sample in samples]
    assert sum("expected leaves with at most" in text for text in told) >= len(samples) / 2, told


def test_lines_stand_out_that_are_brighter_than_their_road():
    """Concrete is three times as bright as asphalt, and yellow half as bright as white."""

    def stand_out(road_texture: int, color: PaintColor) -> bool:
        scene = changed(surface={"road_texture": road_texture}, markings={"grayscale": 0.48, "wear": 0.2})
        return WorldPaint(resolve(scene)).stands_out(color)

    assert [stand_out(1, "white"), stand_out(1, "yellow")] == [True, True]
    assert [stand_out(3, "white"), stand_out(3, "yellow")] == [True, False]


@pytest.mark.parametrize(("px_per_m", "is_shifted"), [(40, True), (60, True), (240, False)])
def test_paint_has_moved_if_it_has_on_the_road_and_not_in_the_pixels_of_a_large_image_alone(px_per_m, is_shifted):
    """Two lines of paint 12 cm wide whose light edges make it seem 8 px to the right: 3 cm in an image of 1920 px."""

    def line(name: str) -> LineProfiles:
        seen = 30 * np.clip(1 - np.abs(PLACES_M - 8 / px_per_m) / 0.12, 0, 1)
        return LineProfiles(name, np.full(100, 300.0), np.full(100, px_per_m), np.tile(seen, (2, 100, 1)))

    assert bool(list(check_move([line("a"), line("b")], 600))) == is_shifted


@pytest.mark.parametrize(("cars_down_px", "expected"), [(0, []), (2, ["image: expected edges where the passes"])])
def test_a_wall_as_bright_as_the_road_with_an_edge_of_its_own_is_no_shift(cars_down_px, expected):
    """Its dark side begins 2 px below its top; cars tell whether the image is shifted."""
    shape = (120, 160)
    passes = {"semantic": np.full(shape, SEMANTIC_IDS["road"], np.uint8), "instance": np.zeros(shape, np.uint16)}
    image = np.full((*shape, 3), 120, np.uint8)
    for left in (10, 60, 110):
        box = np.s_[20:40, left : left + 40]
        passes["semantic"][box], passes["instance"][box] = SEMANTIC_IDS["car"], 1 + left
        image[20 + cars_down_px : 40 + cars_down_px, left : left + 40] = 150
    passes["semantic"][80:110], passes["instance"][80:110] = SEMANTIC_IDS["barrier"], instance_id("structure", 0)
    image[82:110], image[110:112] = 60, 80
    scene = changed(camera={"width_px": shape[1], "height_px": shape[0]})
    found = reasons(Evidence(resolve(scene), ground_truth(scene), image, passes), "alignment").splitlines()
    assert len(found) == len(expected)
    assert all(reason.startswith(words) for reason, words in zip(found, expected, strict=True))


@pytest.mark.thorough
def test_side_cameras_that_motion_blurs_are_told_from_each_other(tmp_path):
    """Not by where their edges are, which the motion moves."""
    camera = "{width_px: 320, height_px: 180, fx: 260, yaw_deg: "
    (tmp_path / "rig.yaml").write_text(f"left: {camera}55}}\nright: {camera}-55}}\n")
    params = load_params("streets", ["weather.kind=clear", "weather.daytime=day", "sensor.motion_blur_m=0.3"])
    settings = RenderSettings(samples=2, passes=("depth", "semantic", "instance"))
    recipe = Recipe(
        Scenes(params, 44, "train", shots=Shots(cameras=load_rig(str(tmp_path / "rig.yaml")))), settings, "jpg"
    )
    left, right = (evidence_of(make_sample(recipe, index).members) for index in range(2))
    assert [reasons(sample, "alignment") for sample in (left, right)] == ["", ""]
    exchanged = (replace(left, image=right.image), replace(right, image=left.image))
    assert any("got none in the image" in reasons(sample, "alignment") for sample in exchanged)


def swapped(pixels: np.ndarray, a: int, b: int) -> np.ndarray:
    return np.where(pixels == a, b, np.where(pixels == b, a, pixels)).astype(pixels.dtype)


def all_to_the_right(sample: Evidence) -> Evidence:
    passes = {name: pixels if name == "height" else aside(pixels, 1) for name, pixels in sample.passes.items()}
    return replace(sample, passes=passes)


# The checks that these tests are about; the program runs them among all others.
OF_PASSES_ALONE = ("kinds", "ids", "pavement", "sky", "normals", "points")
OF_IMAGE_ALONE = ("ridges", "sharpness", "colours", "alignment")
ONE_SAMPLE: dict[str, tuple[Callable[[Evidence], Evidence], str]] = {
    "normals too long": (
        lambda s: with_pass(s, "normal", lambda normal: normal * np.float32(1.05)),
        "normal: expected unit length",
    ),
    "normals with x and y swapped": (
        lambda s: with_pass(s, "normal", lambda n: n[..., [1, 0, 2]]),
        "normal: expected",
    ),
    "car and tree swapped, without instance ids": (
        lambda s: without(with_pass(s, "semantic", lambda ids: swapped(ids, CAR, TREE)), "instance"),
        "semantic: expected pixels of a car within its body",
    ),
    "terrain and road swapped": (
        lambda s: with_pass(s, "semantic", lambda ids: swapped(ids, ROAD, TERRAIN)),
        "passes: expected the pavement within",
    ),
    "road and paint swapped": (
        lambda s: without(with_pass(s, "semantic", lambda ids: swapped(ids, ROAD, MARKING)), "instance"),
        "semantic: expected paint where a line is painted",
    ),
    "all passes 1 px to the right": (all_to_the_right, "instance: expected paint where the line is painted"),
    "sky hit": (
        lambda s: with_pass(s, "depth", lambda depth: np.where(np.isfinite(depth), depth, np.float32(1e10))),
        "depth: expected infinity in the sky and only there",
    ),
}


@pytest.mark.parametrize("fault", first(1, ONE_SAMPLE))
def test_a_fault_of_passes_is_found_in_every_sample_that_has_it(samples, fault):
    plant, words = ONE_SAMPLE[fault]
    for sample in samples:
        assert words in reasons(plant(sample), *OF_PASSES_ALONE)


OF_ANOTHER = {
    "depth": ("sky", "depth:"),
    "normal": ("normals", "normal:"),
    "semantic": ("kinds", "instance: expected ids of the kind"),
    "instance": ("kinds", "instance: expected ids of the kind"),
}


def test_passes_of_another_sample_are_found_each(samples):
    for sample, other in zip(samples, [*samples[1:], samples[0]], strict=True):
        for name, (check_name, words) in OF_ANOTHER.items():
            mixed = replace(sample, passes={**sample.passes, name: other.passes[name]})
            assert words in reasons(mixed, check_name)


def most_seen(sample: Evidence, kind: str) -> list[int]:
    """Instance ids of a kind, those with most pixels first."""
    ids, n = np.unique(sample.passes["instance"], return_counts=True)
    is_kind = numbers_of(kind, ids) >= 0
    return ids[is_kind][np.argsort(-n[is_kind])].tolist()


def test_two_lines_with_each_others_ids_are_both_named(samples):
    for sample in samples:
        first, second, *_ = most_seen(sample, "delimiter")
        lines = [lane.id for lane in sample.labels.lanes if lane.kind == "delimiter"]
        found = findings(with_pass(sample, "instance", lambda ids, a=first, b=second: swapped(ids, a, b)), "ids")
        named = {finding.lane for finding in found if "expected paint where the line is painted" in finding.reason}
        assert named == {lines[thing_of(first)[1]], lines[thing_of(second)[1]]}


def test_two_cars_with_each_others_ids_are_both_named(samples):
    n = 0
    for sample in samples:
        cars = most_seen(sample, "car")[:2]
        if len(cars) == 2 and (sample.passes["instance"] == cars[1]).sum() > 20:
            found = reasons(with_pass(sample, "instance", lambda ids, cars=cars: swapped(ids, *cars)), "ids")
            assert all(f"pixels of car {thing_of(car)[1]} within its body" in found for car in cars)
            n += 1
    assert n


def test_seen_shares_of_cars_in_another_order_or_none_are_found_and_the_car_is_named(samples):
    n = 0
    for sample in samples:
        shares = np.array(sample.labels.car_visible_fraction)
        for wrong in (shares[::-1], np.zeros_like(shares), np.ones_like(shares)):
            cars = np.flatnonzero(np.abs(wrong - shares) > 0.6)
            labels = sample.labels.with_seen_shares(wrong.tolist())
            found = reasons(replace(sample, labels=labels), "cars")
            assert all(f"of car {car} by its" in found for car in cars)
            n += len(cars)
    assert n


IMAGES: dict[str, tuple[Callable[[np.ndarray], np.ndarray], str]] = {
    "1 px right": (lambda image: aside(image, 1), "edges where the passes have them, got +1 px right"),
    "3 px right": (lambda image: aside(image, 3), "edges where the passes have them, got +3 px right"),
    "3 px down": (lambda image: np.swapaxes(aside(np.swapaxes(image, 0, 1), 3), 0, 1), "got +3 px down"),
    "stretched by 1 %": (drawn(partial(stretched, 1.01)), "px right in its"),
    "stretched by 5 %": (drawn(partial(stretched, 1.05)), "edges where the passes have them"),
    "mirrored": (lambda image: image[:, ::-1], "edges where the passes have them"),
    "BGR": (lambda image: image[..., ::-1], "expected red, green and blue in this order"),
    **{
        f"half resolution, {how.name}": (drawn(partial(coarse, how)), "expected detail of single pixels")
        for how in (Image.Resampling.NEAREST, Image.Resampling.BILINEAR, Image.Resampling.LANCZOS)
    },
}


def as_jpeg(image: np.ndarray) -> np.ndarray:
    return decode_image(encode_image(np.ascontiguousarray(image.astype(np.uint8)), "jpg"), "")


# One of places, one of colours, one of detail.
FIRST_IMAGES = ("3 px right", "BGR", "half resolution, BILINEAR")


@pytest.mark.parametrize("fault", first(len(FIRST_IMAGES), sorted(IMAGES, key=lambda name: name not in FIRST_IMAGES)))
def test_a_fault_of_the_image_is_found_in_every_sample_that_has_it(samples, fault):
    plant, words = IMAGES[fault]
    for sample in samples:
        assert words in reasons(replace(sample, image=as_jpeg(plant(sample.image))), *OF_IMAGE_ALONE)


def test_the_image_of_another_sample_has_no_edges_and_no_paint_here(samples):
    n_bare = 0
    for sample, other in zip(samples, [*samples[1:], samples[0]], strict=True):
        wrong = replace(sample, image=other.image)
        assert "edges where the passes have them" in reasons(wrong, "alignment")
        n_bare += "image: expected" in reasons(replace(wrong, passes={}), "ridges")
    assert n_bare >= len(samples) / 2, "without passes"


@pytest.mark.parametrize("fault", first(2, ["3 px right", "BGR", "stretched by 5 %", "half resolution, BILINEAR"]))
def test_without_passes_the_image_still_tells_where_it_shows_paint_and_terrain(samples, fault):
    plant, words = IMAGES[fault]
    words = "got it clearest" if "passes" in words else words
    bare = [replace(sample, image=as_jpeg(plant(sample.image)), passes={}) for sample in samples]
    told = [words in reasons(sample, *OF_IMAGE_ALONE) for sample in bare]
    assert sum(told) >= len(samples) - 1


def test_an_image_that_shows_no_lane_needs_no_detail(dataset, only):
    """It may be all clouds, or the smooth back of a van."""
    only("sharpness")
    half = next(fault for fault in FAULTS if fault.name == "image of half its resolution")

    def hide_lanes(labels: Labels) -> Labels:
        lanes = [replace(lane, in_image=np.zeros_like(lane.in_image)) for lane in labels.lanes]
        return replace(labels, lanes=tuple(lanes))

    def blur_all_and_hide_lanes_of_one(samples: dict[int, Members]) -> None:
        for members in samples.values():
            half.spoil(members)
        relabel(1, hide_lanes)(samples)

    seal(dataset, blur_all_and_hide_lanes_of_one)
    judged = {problem.where for problem in check(dataset).problems if "expected detail" in problem.reason}
    assert judged == {"train:00000000", "train:00000002", "train:00000003"}
