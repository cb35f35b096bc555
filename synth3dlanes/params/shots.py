"""The pictures of a scene: the frames of a clip, the cameras of a rig, and the samples that show them."""

from typing import Annotated, NamedTuple

from pydantic import Field, ValidationError, model_validator

from synth3dlanes.params.cameras import CameraSpec
from synth3dlanes.params.groups import Group, left_out_at
from synth3dlanes.params.lidars import LidarSpec
from synth3dlanes.scene.host import MAX_BEHIND_M, MAX_CAMERAS, MAX_FRAMES
from synth3dlanes.scene.settings import MAX_VIEWS
from synth3dlanes.system.errors import InputError
from synth3dlanes.system.schema import is_none, validation_problems
from synth3dlanes.system.words import counted


class ShotNumbers(NamedTuple):
    """The numbers of the scene, the frame, the camera and the view that a sample shows."""

    scene: int
    frame: int
    camera: int
    view: int = 0


class Shots(Group):
    """How each scene is seen: in `frames` frames, `fps` a second, by each camera of `cameras`. Without `cameras`, the
    camera of the parameters is used. With a `lidar`, every sample has its sweep. With `views`, the host has this number
    of places in each scene, and each is a picture by all cameras."""

    frames: Annotated[int, Field(ge=1, le=MAX_FRAMES)] = 1
    fps: Annotated[float, Field(gt=0, le=1000)] = 10.0
    cameras: Annotated[tuple[CameraSpec, ...], Field(max_length=MAX_CAMERAS)] = ()
    lidar: Annotated[LidarSpec | None, Field(exclude_if=is_none)] = None
    views: Annotated[int, Field(ge=1, le=MAX_VIEWS)] = left_out_at(1)

    @model_validator(mode="after")
    def _is_no_clip(self) -> "Shots":
        """Check that no clip has several views."""
        if self.frames > 1 and self.views > 1:
            raise ValueError(f"views_per_scene: expected 1 beside frames of 2 or more, got {self.views}")
        return self

    @property
    def n_cameras(self) -> int:
        """How many cameras see every frame."""
        return max(1, len(self.cameras))

    @property
    def behind_m(self) -> float:
        """The range of labels behind the host, in metres: the range ahead if a camera looks sideways or back, else
        0."""
        return 0.0 if all(spec.looks_ahead for spec in self.cameras) else MAX_BEHIND_M

    @property
    def per_scene(self) -> int:
        """The number of samples that show one scene."""
        return self.views * self.frames * self.n_cameras

    def place(self, index: int) -> ShotNumbers:
        """The numbers that sample `index` has, where index = ((scene x views + view) x frames + frame) x cameras +
        camera."""
        of_frame, camera = divmod(index, self.n_cameras)
        of_view, frame = divmod(of_frame, self.frames)
        scene, view = divmod(of_view, self.views)
        return ShotNumbers(scene, frame, camera, view)

    def index(self, place: ShotNumbers) -> int:
        """The index of the sample with these numbers: the inverse of `place`."""
        of_view = place.scene * self.views + place.view
        return (of_view * self.frames + place.frame) * self.n_cameras + place.camera

    def text(self, n: int) -> str:
        """What `n` samples show, as text for a person; "" for single pictures."""
        if self.views > 1:
            return f"{counted(-(-n // self.per_scene), 'world')} of {self.views} views"
        if self.frames == 1:
            return ""
        n_frames = -(-n // self.n_cameras)
        cut, clips = n_frames % self.frames, -(-n_frames // self.frames)
        end = f", the last of {cut} frame{'s' * (cut > 1)}" if cut else ""
        return f"{clips} clip{'s' * (clips > 1)} of {self.frames} frames, {self.fps:g} a second{end}"


SINGLE = Shots()


def clips(frames: int, fps: float, cameras: tuple[CameraSpec, ...] = (), views: int = 1) -> Shots:
    """Clips of `frames` frames, or `views` single pictures of each scene if `frames` is 1, taken by these cameras.
    Raises InputError for numbers out of range."""
    try:
        return Shots(cameras=cameras, views=views, **({"frames": frames, "fps": fps} if frames != 1 else {}))
    except ValidationError as error:
        raise InputError(*(line.removeprefix(": ") for line in validation_problems(error, ""))) from None
