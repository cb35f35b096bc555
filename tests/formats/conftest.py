"""A small dataset on disk: sampled scenes, images that show the lanes, no Blender."""

import numpy as np
import pytest
from PIL import Image, ImageDraw

N_TRAIN, N_TEST = 7, 4


def _image(labels):
    camera = labels.camera
    image = Image.new("RGB", (camera.width_px, camera.height_px), (90, 110, 130))
    draw = ImageDraw.Draw(image)
    for lane in labels.lanes:
        if lane.visible.sum() > 1:
            homogeneous = lane.xyz_cam[lane.visible] @ camera.img_from_cam.T
            points_img = homogeneous[:, :2] / homogeneous[:, 2:]
            draw.line([tuple(point - 0.5) for point in points_img], fill=(255, 255, 255))
    return np.asarray(image)


@pytest.fixture(scope="session")
def write_split():
    """Writes `n` samples of a split under a folder, as `generate` lays them out; `make_passes` makes the passes of
    labels."""
    from synth3dlanes.dataset.folder import claim
    from synth3dlanes.dataset.format import Picture, encode, member_names
    from synth3dlanes.dataset.write import Shard
    from synth3dlanes.draw.sample import Scenes, sample_scene
    from synth3dlanes.params.params import load_params
    from synth3dlanes.scene import scene as scene_format
    from synth3dlanes.truth.ground_truth import ground_truth
    from tests import fake_samples

    def write(root, split, n, changes=(), make_passes=None):
        params = load_params("appendix_i", ["cars.n=3", "trees.n=5", *changes])
        names = ("semantic", "instance") if make_passes else ()
        description = {**fake_samples.recipe(image_format="jpg").description(), "shard_size": 1000}
        description["render"] = {**description["render"], "passes": list(names)}
        with claim(root, description, split, n, [0]) as folder:
            shard = Shard(folder, 0, 1000, member_names("jpg", names))
            for index in shard.missing(n):
                scene = sample_scene(Scenes(params, 0, split), index)
                labels = ground_truth(scene)
                passes = make_passes(labels) if make_passes else {}
                shard.write_part(
                    index, encode(Picture(_image(labels), labels, passes), scene_format.to_json(scene), "jpg")
                )
            shard.join(n)

    return write


@pytest.fixture(scope="session")
def dataset(made_once, write_split):
    """A folder with the splits `train` and `test`."""

    def make(root):
        write_split(root, "train", N_TRAIN)
        write_split(root, "test", N_TEST)

    return made_once("dataset", make)


@pytest.fixture(scope="session")
def few(made_once, write_split):
    """A folder with four frames: three of `train` and one of `test`."""

    def make(root):
        write_split(root, "train", 3)
        write_split(root, "test", 1)

    return made_once("few", make)


@pytest.fixture(scope="session")
def two_frames(made_once, write_split):
    """A folder with two frames for tests, with passes. Neither the road nor the camera's place on it is symmetric."""
    from tests.formats.test_segmentation import passes_of

    changes = ["road.topology=1", "road.n_lanes=3", "camera.width_px=480"]
    return made_once("two_frames", lambda root: write_split(root, "test", 2, changes, passes_of))


@pytest.fixture(scope="session")
def export_of(made_once, two_frames):
    """Gives the export of these in a format, which is right, and is copied before it is changed."""
    from synth3dlanes.formats.export import Export
    from tests.formats.planting import problems

    def exported(name):
        def make(out):
            Export(str(two_frames), out, name).write()
            assert not problems(two_frames, out, name)

        return Export(str(two_frames), made_once(f"two_frames_{name}", make), name)

    return exported
