"""What figures show of a scene and of a sample."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from synth3dlanes.imaging.sweep import Sweep
from synth3dlanes.labels.labels import Labels
from synth3dlanes.scene.host import Shot
from synth3dlanes.scene.scene import Scene
from synth3dlanes.system.arrays import Passes, RgbImage


@dataclass(frozen=True, eq=False)
class ShownScene:
    """A scene with its name (of a sample: its key) and its labels; a sample that was lifted from a real drive has no
    scene. What else there is of it: its image, passes and lidar sweep; the frames of its clip, of which it is that of
    `shot`; and what all cameras of its rig see at its instant."""

    scene: Scene | None
    labels: Labels
    image: RgbImage | None = None
    passes: Passes = field(default_factory=dict)
    sweep: Sweep | None = None
    clip: Sequence[tuple[Labels, RgbImage]] = ()
    rig: Sequence[tuple[Labels, RgbImage]] = ()
    name: str = "scene"
    lifted_shot: Shot | None = None

    @property
    def shot(self) -> Shot:
        """Which picture of its scene it is; of a lifted sample `lifted_shot`."""
        return self.scene.shot if self.scene is not None else self.lifted_shot or Shot()


@dataclass(frozen=True, eq=False)
class ShownSample:
    """A picture of a sample, its name, and the labels to be drawn on it, if any."""

    name: str
    image: RgbImage
    labels: Labels | None = None
