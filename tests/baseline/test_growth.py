"""A larger network that starts from the weights of a smaller one computes the same."""

import pytest
import torch
from synth3dlanes_baseline.checkpoint import Checkpoint, save
from synth3dlanes_baseline.config import train_config
from synth3dlanes_baseline.devices import Process
from synth3dlanes_baseline.model import LaneNet
from synth3dlanes_baseline.pretrained import grown, load_weights
from synth3dlanes_baseline.run_state import prepare

from synth3dlanes.system.errors import InputError

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
