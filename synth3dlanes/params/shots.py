"""The pictures of a scene: the frames of a clip, the cameras of a rig, and the samples that show them."""

from typing import Annotated, NamedTuple

from pydantic import Field, ValidationError

from synth3dlanes.params.cameras import CameraSpec
from synth3dlanes.params.groups import Group
from synth3dlanes.params.lidars import LidarSpec
from synth3dlanes.scene.host import MAX_BEHIND_M, MAX_CAMERAS, MAX_FRAMES
from synth3dlanes.system.errors import InputError
from synth3dlanes.system.schema import validation_problems


class ShotNumbers(NamedTuple):
    """The numbers of the scene, the frame and the camera that a sample shows."""

    scene: int
    frame: int
    camera: int


class Shots(Group):
    """How each scene is seen: in `frames` frames, `fps` a second, by each camera of `cameras`. Without `cameras`, the
    camera of the parameters is used. With a `lidar`, every sample has its sweep."""

    frames: Annotated[int, Field(ge=1, le=MAX_FRAMES)] = 1
    fps: Annotated[float, Field(gt=0, le=1000)] = 10.0
    cameras: Annotated[tuple[CameraSpec, ...], Field(max_length=MAX_CAMERAS)] = ()
    lidar: Annotated[LidarSpec | None, Field(exclude_if=lambda lidar: lidar is None)] = None

    @property
    def n_cameras(self) -> int:
        """How many cameras see every frame."""
        return max(1, len(self.cameras))

    @property
    def behind_m(self) -> float:
        """How far behind the host lanes are labelled, in metres: as far as ahead if a camera looks sideways or back,
        else 0."""
        return 0.0 if all(spec.looks_ahead for spec in self.cameras) else MAX_BEHIND_M

    @property
    def per_scene(self) -> int:
        """The number of samples that show one scene."""
        return self.frames * self.n_cameras

    def place(self, index: int) -> ShotNumbers:
        """The numbers of scene, frame and camera of sample `index`, where index = (scene x frames + frame) x cameras +
        camera."""
        of_frame, camera = divmod(index, self.n_cameras)
        return ShotNumbers(*divmod(of_frame, self.frames), camera)

    def index(self, place: ShotNumbers) -> int:
        """The index of the sample with these numbers: the inverse of `place`."""
        return (place.scene * self.frames + place.frame) * self.n_cameras + place.camera

    def text(self, n: int) -> str:
        """What `n` samples show, as text for a person; "" for single pictures."""
        if self.frames == 1:
            return ""
        n_frames = -(-n // self.n_cameras)
        cut, clips = n_frames % self.frames, -(-n_frames // self.frames)
        end = f", the last of {cut} frame{'s' * (cut > 1)}" if cut else ""
        return f"{clips} clip{'s' * (clips > 1)} of {self.frames} frames, {self.fps:g} a second{end}"


SINGLE = Shots()


def clips(frames: int, fps: float, cameras: tuple[CameraSpec, ...] = ()) -> Shots:
    """Clips of `frames` frames, or single pictures if `frames` is 1, taken by these cameras. Raises InputError for
    numbers out of range."""
    if frames == 1:
        return Shots(cameras=cameras)
    try:
        return Shots(frames=frames, fps=fps, cameras=cameras)
    except ValidationError as error:
        raise InputError(*(line.removeprefix(": ") for line in validation_problems(error, ""))) from None
