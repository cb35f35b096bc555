"""Traffic elements in labels: the head of every signal and the face of every sign, what they show, and the lanes that
they govern. Pure data.

The frame of an element has its origin in the middle of its box, x to the right and y ahead as the traffic that it is
for drives, z up: its face looks along -y. Rectangles are as in `object_labels`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from jaxtyping import Float, Int
from pydantic import Field, with_config

from synth3dlanes.geometry.frames import from_axes, rotation, transform
from synth3dlanes.labels.object_labels import CORNERS, document_of, rows
from synth3dlanes.scene.traffic_elements import ElementCategory, ElementKind, ElementState, GovernedLanes
from synth3dlanes.system.arrays import Matrix4
from synth3dlanes.system.json_arrays import JsonPixelRectangle, JsonQuaternion, JsonRectangle, JsonSize3, JsonVector3
from synth3dlanes.system.schema import STRICT, Unit


@with_config(STRICT)
@dataclass(frozen=True, eq=False)
class ElementLabel:
    """One traffic element.

    `id` is its number in the pass `instance`; it is the same in all pictures of a scene. `kind` is the form of a
    light's lenses, `lane` over a lane, or what a sign shows; `state` is what a signal shows in this picture, None of a
    sign. `lanes` are ids of segments of the lane graph. `size_m` is width, depth and height. `box_px`,
    `unclipped_box_px`, `seen_box_px` and `visible_fraction` are as those of an object, but that `visible_fraction` is
    measured on the image's pixels."""

    id: Annotated[int, Field(ge=1)]
    category: ElementCategory
    kind: ElementKind
    state: ElementState | None
    lanes: GovernedLanes
    size_m: JsonSize3
    center_cam: JsonVector3
    rotation_wxyz: JsonQuaternion
    box_px: JsonRectangle | None
    unclipped_box_px: JsonRectangle | None
    seen_box_px: JsonPixelRectangle | None = None
    visible_fraction: Unit | None = None

    @property
    def cam_from_element(self) -> Matrix4:
        """The pose of its frame."""
        x, y, z = rotation(self.rotation_wxyz).T
        return from_axes(x, y, z, self.center_cam)

    @property
    def corners_cam(self) -> Float[np.ndarray, "8 3"]:
        """The corners of its box in the order of CORNERS: the back, then the face."""
        return transform(self.cam_from_element, CORNERS * self.size_m / 2)

    @property
    def normal_cam(self) -> Float[np.ndarray, "3"]:
        """The unit vector along which its face looks."""
        return -rotation(self.rotation_wxyz)[:, 1]


@dataclass(frozen=True, eq=False)
class TrafficElements:
    """The traffic elements of a sample as arrays, one row for each, with the fields of `ElementLabel`. NaN where these
    are None; `governs[i, k]` says whether element i governs segment k of the lane graph."""

    id: Int[np.ndarray, " n"]
    category: tuple[ElementCategory, ...]
    kind: tuple[ElementKind, ...]
    state: tuple[ElementState | None, ...]
    lanes: tuple[tuple[str, ...], ...]
    governs: Int[np.ndarray, "n k"]
    size_m: Float[np.ndarray, "n 3"]
    cam_from_element: Float[np.ndarray, "n 4 4"]
    corners_cam: Float[np.ndarray, "n 8 3"]
    normal_cam: Float[np.ndarray, "n 3"]
    box_px: Float[np.ndarray, "n 4"]
    unclipped_box_px: Float[np.ndarray, "n 4"]
    seen_box_px: Float[np.ndarray, "n 4"]
    visible_fraction: Float[np.ndarray, " n"]

    def __len__(self) -> int:
        return len(self.id)


def element_arrays(items: Sequence[ElementLabel], segments: Sequence[str]) -> TrafficElements:
    """Traffic elements as arrays; `segments` are the ids of the lane graph in its order."""
    governs = [[int(segment in item.lanes) for segment in segments] for item in items]
    return TrafficElements(
        id=np.array([item.id for item in items], int),
        category=tuple(item.category for item in items),
        kind=tuple(item.kind for item in items),
        state=tuple(item.state for item in items),
        lanes=tuple(item.lanes for item in items),
        governs=np.array(governs, int).reshape(len(items), len(segments)),
        size_m=rows(items, "size_m", 3),
        cam_from_element=rows(items, "cam_from_element", 4, 4),
        corners_cam=rows(items, "corners_cam", 8, 3),
        normal_cam=rows(items, "normal_cam", 3),
        box_px=rows(items, "box_px", 4),
        unclipped_box_px=rows(items, "unclipped_box_px", 4),
        seen_box_px=rows(items, "seen_box_px", 4),
        visible_fraction=rows(items, "visible_fraction"),
    )


# Decimals in the JSON form: corners are off by less than 0.1 mm.
DECIMALS = {"size_m": 4, "center_cam": 4, "rotation_wxyz": 6, "box_px": 1, "unclipped_box_px": 1}


def element_document(item: ElementLabel) -> dict[str, Any]:
    """The JSON form of a traffic element."""
    return {**document_of(vars(item), DECIMALS), "lanes": list(item.lanes)}
