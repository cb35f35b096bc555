"""The pictures of a scene: the frames of a clip, the cameras of a rig, and the samples that show them."""

from typing import Annotated, NamedTuple

from pydantic import Field

from synth3dlanes.cameras import CameraSpec
from synth3dlanes.lidars import LidarSpec
from synth3dlanes.params import Group
from synth3dlanes.scene import MAX_CAMERAS, MAX_FRAMES


class Place(NamedTuple):
    """What a sample of a split shows: the number of its scene, of the frame and of the camera."""

    scene: int
    frame: int
    camera: int


class Shots(Group):
    """Every scene is seen in `frames` frames, `fps` a second, by each of the cameras of a rig; without any, by the
    camera of the parameters. Each of its samples has the sweep of the lidar, if there is one."""

    frames: Annotated[int, Field(ge=1, le=MAX_FRAMES)] = 1
    fps: Annotated[float, Field(gt=0, le=1000)] = 10.0
    cameras: Annotated[tuple[CameraSpec, ...], Field(max_length=MAX_CAMERAS)] = ()
    lidar: Annotated[LidarSpec | None, Field(exclude_if=lambda lidar: lidar is None)] = None

    @property
    def n_cameras(self) -> int:
        """How many cameras see every frame."""
        return max(1, len(self.cameras))

    @property
    def per_scene(self) -> int:
        """How many samples show one scene."""
        return self.frames * self.n_cameras

    def place(self, index: int) -> Place:
        """What sample `index` shows: index = (scene x frames + frame) x cameras + camera."""
        of_frame, camera = divmod(index, self.n_cameras)
        return Place(*divmod(of_frame, self.frames), camera)


SINGLE = Shots()
