"""Objects in labels: the 3D box of every car, thing and traffic element, and its rectangles in the image. Pure data.

The frame of an object has its origin in the middle of the box and the axes of the model: x right, y forward, z up. That
of a traffic element has x to the right and y ahead as the traffic that it is for drives: its face looks along -y.
Rectangles are (left, top, right, bottom) in pixels.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
from jaxtyping import Float, Int, Integer
from pydantic import Field, with_config

from synth3dlanes.geometry.frames import from_axes, rotation, transform
from synth3dlanes.scene.instance_ids import END
from synth3dlanes.scene.things import ELEMENTS, ObjectCategory
from synth3dlanes.scene.traffic_elements import ElementKind, ElementState, GovernedLanes
from synth3dlanes.system.arrays import Matrix4
from synth3dlanes.system.json_arrays import (
    JsonPixelRectangle,
    JsonQuaternion,
    JsonRectangle,
    JsonSize3,
    JsonVector3,
    rounded,
)
from synth3dlanes.system.schema import STRICT, Unit

# Corners of a box of size 2 in the frame of its object: four of the front, then four of the rear, each four from the
# top left, clockwise as seen from behind.
CORNERS = np.array([[x, y, z] for y in (1.0, -1.0) for x, z in ((-1, 1), (1, 1), (1, -1), (-1, -1))])

NonNegative = Annotated[int, Field(ge=0)]


# Keys that only traffic elements have, and that only others have.
OF_ELEMENTS, OF_OTHERS = ("kind", "state", "lanes"), ("velocity_cam", "truncation", "lidar_points")


@with_config(STRICT)
@dataclass(frozen=True, eq=False, kw_only=True)
class ObjectLabel:
    """The box of one object.

    `id` is its number in the pass `instance`; it is the same in all pictures of a scene. `size_m` is width, length and
    height, along x, y and z of its frame. `center_cam` is the middle of the box, `rotation_wxyz` the unit quaternion
    that turns vectors of its frame into the camera's. `velocity_cam` is the velocity over the ground along the
    camera's axes, metres per second; None in single pictures, which have no time.

    `box_px` bounds the part of the 3D box that is inside the image, None where no part is. `unclipped_box_px` bounds
    the whole 3D box, None where it reaches behind the camera, out of the lens's field or a million pixels away.
    `truncation` is the share of the 3D box that is outside the image. `seen_box_px` bounds the pixels that show the
    object, None where no pixel does, and until rendered. `visible_fraction` is the share of the object's pixels in the
    image that nothing hides, 0 without any, None until rendered. `lidar_points` counts the points of the sweep on the
    object, None without a lidar.

    Traffic elements alone have `kind` (the form of a light's lenses, `lane` over a lane, or what a sign shows), `state`
    (what a signal shows in this picture; None for a sign) and `lanes` (the ids of the segments of the lane graph that
    they govern). They have no `velocity_cam`, `truncation` and `lidar_points`; their `visible_fraction` is measured on
    the image's pixels."""

    id: Annotated[int, Field(ge=1)]
    category: ObjectCategory
    kind: ElementKind | None = None
    state: ElementState | None = None
    lanes: GovernedLanes = ()
    size_m: JsonSize3
    center_cam: JsonVector3
    rotation_wxyz: JsonQuaternion
    velocity_cam: JsonVector3 | None = None
    box_px: JsonRectangle | None
    unclipped_box_px: JsonRectangle | None
    truncation: Unit | None = None
    seen_box_px: JsonPixelRectangle | None = None
    visible_fraction: Unit | None = None
    lidar_points: NonNegative | None = None

    def __post_init__(self) -> None:
        """Check that it has what traffic elements have, or what others have; raise ValueError."""
        if (self.kind is None, self.truncation is not None) != (not self.is_element,) * 2:
            wanted = "a kind and no truncation" if self.is_element else "a truncation and no kind"
            raise ValueError(f"category: expected {wanted} of a {self.category}, got others")

    @property
    def is_element(self) -> bool:
        """Whether it is a traffic element."""
        return self.category in ELEMENTS

    @property
    def cam_from_object(self) -> Matrix4:
        """The pose of the frame of the object."""
        x, y, z = rotation(self.rotation_wxyz).T
        return from_axes(x, y, z, self.center_cam)

    @property
    def cam_from_element(self) -> Matrix4:
        """The name that `cam_from_object` of a traffic element had before objects and elements were one class."""
        return self.cam_from_object

    @property
    def corners_cam(self) -> Float[np.ndarray, "8 3"]:
        """The corners of the box in the order of CORNERS."""
        return transform(self.cam_from_object, CORNERS * self.size_m / 2)

    @property
    def normal_cam(self) -> Float[np.ndarray, "3"]:
        """The unit vector against its y, along which the face of a traffic element looks."""
        return -rotation(self.rotation_wxyz)[:, 1]


@dataclass(frozen=True, eq=False)
class Objects:
    """The objects or the traffic elements of a sample as arrays, one row for each, with the fields of `ObjectLabel`.
    Numbers are NaN where these are None, `lidar_points` -1. `corners_cam` are in the order of CORNERS. `governs[i, k]`
    says whether element i governs segment k of the lane graph."""

    id: Int[np.ndarray, " n"]
    category: tuple[ObjectCategory, ...]
    kind: tuple[ElementKind | None, ...]
    state: tuple[ElementState | None, ...]
    lanes: tuple[tuple[str, ...], ...]
    governs: Int[np.ndarray, "n k"]
    size_m: Float[np.ndarray, "n 3"]
    cam_from_object: Float[np.ndarray, "n 4 4"]
    corners_cam: Float[np.ndarray, "n 8 3"]
    normal_cam: Float[np.ndarray, "n 3"]
    velocity_cam: Float[np.ndarray, "n 3"]
    box_px: Float[np.ndarray, "n 4"]
    unclipped_box_px: Float[np.ndarray, "n 4"]
    seen_box_px: Float[np.ndarray, "n 4"]
    visible_fraction: Float[np.ndarray, " n"]
    truncation: Float[np.ndarray, " n"]
    lidar_points: Int[np.ndarray, " n"]

    def __len__(self) -> int:
        return len(self.id)

    @property
    def cam_from_element(self) -> Float[np.ndarray, "n 4 4"]:
        """The name that `cam_from_object` of traffic elements had before objects and elements were one class."""
        return self.cam_from_object


def rows(items: Sequence[object], name: str, *shape: int) -> Float[np.ndarray, "..."]:
    """A field of a shape of each item; NaN where it is None."""
    values = (getattr(item, name) for item in items)
    filled = [np.full(shape, np.nan) if value is None else np.asarray(value, float) for value in values]
    return np.array(filled).reshape(len(items), *shape)


def stacked(items: Sequence[ObjectLabel], segments: Sequence[str] = ()) -> Objects:
    """Objects as arrays; `segments` are the ids of the lane graph in its order."""
    counts = [-1 if item.lidar_points is None else item.lidar_points for item in items]
    governs = [[int(segment in item.lanes) for segment in segments] for item in items]
    return Objects(
        id=np.array([item.id for item in items], int),
        category=tuple(item.category for item in items),
        kind=tuple(item.kind for item in items),
        state=tuple(item.state for item in items),
        lanes=tuple(item.lanes for item in items),
        governs=np.array(governs, int).reshape(len(items), len(segments)),
        size_m=rows(items, "size_m", 3),
        cam_from_object=rows(items, "cam_from_object", 4, 4),
        corners_cam=rows(items, "corners_cam", 8, 3),
        normal_cam=rows(items, "normal_cam", 3),
        velocity_cam=rows(items, "velocity_cam", 3),
        box_px=rows(items, "box_px", 4),
        unclipped_box_px=rows(items, "unclipped_box_px", 4),
        seen_box_px=rows(items, "seen_box_px", 4),
        visible_fraction=rows(items, "visible_fraction"),
        truncation=rows(items, "truncation"),
        lidar_points=np.array(counts, int),
    )


def as_seen(
    items: Sequence[ObjectLabel],
    instance: Integer[np.ndarray, "h w"],
    lidar_instance: Integer[np.ndarray, " n"] | None = None,
) -> tuple[ObjectLabel, ...]:
    """The objects with what the ids of an image's pixels and of a lidar's points tell of them."""
    rows, columns = np.nonzero(np.isin(instance, [item.id for item in items]))
    own = instance[rows, columns]
    counts = None if lidar_instance is None else np.bincount(lidar_instance, minlength=END)
    return tuple(
        replace(
            item,
            seen_box_px=rectangle_around(rows[own == item.id], columns[own == item.id]),
            lidar_points=None if counts is None else int(counts[item.id]),
        )
        for item in items
    )


def rectangle_around(rows: Int[np.ndarray, " n"], columns: Int[np.ndarray, " n"]) -> Int[np.ndarray, "4"] | None:
    """The rectangle around whole pixels; None without any."""
    if not rows.size:
        return None
    return np.array([columns.min(), rows.min(), columns.max() + 1, rows.max() + 1])


# Decimals in the JSON form: corners are off by less than 0.1 mm.
JSON_DECIMALS = {
    "size_m": 4, "center_cam": 4, "rotation_wxyz": 6, "velocity_cam": 3, "box_px": 1, "unclipped_box_px": 1
}  # fmt: skip


def object_document(item: ObjectLabel) -> dict[str, Any]:
    """The JSON form of an object."""
    others = OF_OTHERS if item.is_element else OF_ELEMENTS
    fields = {name: value for name, value in vars(item).items() if name not in others}
    return {name: _json(value, JSON_DECIMALS.get(name, 0)) for name, value in fields.items()}


def _json(value: object, decimals: int) -> object:
    if isinstance(value, np.ndarray):
        return rounded(value, decimals) if decimals else value.tolist()
    return value
