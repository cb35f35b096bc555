"""The list of all checks of a sample: the program runs them, the tests do, and docs/validate.md names them."""

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import NamedTuple

from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.validate.findings import Finding, Result
from synth3dlanes.validate.integrity import check_row
from synth3dlanes.validate.labels import check_form, check_labels
from synth3dlanes.validate.moving import instant
from synth3dlanes.validate.passes import check_bonnet, check_normals, check_sky, disagreement
from synth3dlanes.validate.picture import check_alignment, check_appearance, check_colours, check_frame, check_sharpness
from synth3dlanes.validate.points import check_cars, check_points
from synth3dlanes.validate.ridges import check_ridges
from synth3dlanes.validate.seen import check_lidar, check_seen


class Check(NamedTuple):
    """A check: its name, what it does with evidence, what it finds, and which parts of the evidence it cannot do
    without: passes by their names, `scene`, `image`, `lidar`, `row` of the index, and `aim`:
    points that are in the image where their masks say so."""

    name: str
    of: Callable[[Evidence], Iterable[Result]]
    finds: str
    needs: frozenset[str] = frozenset({"scene"})


def _row(evidence: Evidence) -> Iterator[Finding]:
    assert evidence.entry is not None
    scene = None if evidence.known_world is None else evidence.scene
    return check_row(evidence.entry, scene, evidence.labels, evidence.numbers)


def _needs(words: str) -> frozenset[str]:
    return frozenset({"scene", *words.split()})


# Parts of the evidence that every complete sample of a data set of scenes has.
ALWAYS = _needs("row image aim")

CHECKS = (
    Check("index", _row, "index columns that do not match their sample", frozenset({"row"})),
    Check("form", check_form, "lanes that turn back or jump, masks that do not fit the camera", frozenset()),
    Check("labels", check_labels, "labels that are not those of the scene; with `instance`, labels of objects, signals "
          "and signs that count other pixels than their ids show, with `lidar` other points"),
    Check("bonnet", check_bonnet, "a bonnet of the host that is not in the picture", _needs("semantic")),
    Check("roadside", partial(check_seen, "roadside"), "rails, posts and buildings on a pavement"),
    Check("frame", check_frame, "black or white images", frozenset({"image"})),
    Check("standing", partial(check_seen, "standing"), "wheels, trunks and structures that do not touch the ground"),
    Check("lidar", check_lidar, "points that are not on the ground, in the body or in the paint that their ids say, "
          "or have ids of another kind, paint that no point has, and beams through cars", _needs("lidar")),
    Check("points", check_points, "points off the ground, points labelled as visible that the passes show to be "
          "hidden; depth in another unit", _needs("aim")),
    Check("height", partial(check_seen, "height"), "a height map that is too high or low, or some cells off",
          _needs("height")),
    Check("ridges", check_ridges, "paint in the image that is not where its delimiter is; in photographs of a drive, "
          "paint that is aside of all its lines", frozenset({"aim", "image"})),
    Check("sharpness", check_sharpness, "images of lower resolution than their size", _needs("aim image")),
    Check("colours", check_colours, "pink ground, swapped colour channels", _needs("aim image")),
    Check("appearance", check_appearance, "by clear daylight: gray pictures, swapped or turned colours, black parts, "
          "white lines that are yellow, lines whose paint is missing",
          _needs("aim image depth semantic")),
    Check("alignment", check_alignment, "an image that is shifted or stretched against the passes, or of another scene",
          _needs("aim image semantic")),
    Check("symbols", partial(check_seen, "symbols"), "arrows, stop lines, crosswalks and gores in another place than "
          "the scene's, or missing", _needs("aim depth semantic")),
    Check("pavement", partial(check_seen, "pavement"), "a road or ramp that does not match the scene, swapped ids of "
          "road and shoulder; with `normal`, normals in another frame, or bent at edges", _needs("aim depth semantic")),
    Check("terrain", partial(check_seen, "terrain"), "hills that do not match the scene, terrain that covers the road",
          _needs("aim depth semantic")),
    Check("sky", check_sky, "holes in the ground, through which the sky shows; with `depth`, depth that is finite in "
          "the sky, or infinite elsewhere", _needs("aim semantic")),
    Check("normals", check_normals, "normals of another length, or facing away", _needs("aim normal")),
    Check("kinds", lambda of: disagreement("instance", of.scene, of.passes["semantic"], of.passes["instance"]),
          "ids of another kind of thing, also of people and riders that are taken for each other",
          _needs("aim semantic instance")),
    Check("ids", partial(check_seen, "ids"), "cars, people, trees, structures and lines elsewhere than their ids say, "
          "and lines without paint", _needs("aim depth")),
    Check("cars", check_cars, "a `visible_fraction` that does not match the object's pixels", _needs("aim instance")),
    Check("moving", instant, "from picture to picture of a clip, rig or drive: lines that are elsewhere, objects that "
          "do not move as the velocities of their labels say, or that cameras have in different places", frozenset()),
)  # fmt: skip
