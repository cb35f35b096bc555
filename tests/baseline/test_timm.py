"""Trunks of timm: where their features lie, their weights from files, and a network around them."""

import sys

import pytest
import torch
from safetensors.torch import save_file
from synth3dlanes_baseline.backbone import ImagePathway
from synth3dlanes_baseline.config import MODELS, PAPER, train_config
from synth3dlanes_baseline.layers import PIXELS, lattice_after
from synth3dlanes_baseline.model import LaneNet
from synth3dlanes_baseline.pretrained import load_pretrained
from synth3dlanes_baseline.timm_trunk import TimmPathway, measured_lattices
from torch import nn

from synth3dlanes.errors import FormatError, InputError, MissingPackageError


@pytest.fixture(scope="module")
def timm():
    """timm, also beside a CPU build of torch, where torchvision, which it imports, may lack two operators."""
    library = torch.library.Library("torchvision", "FRAGMENT")
    for name in ("nms", "qnms"):
        if not hasattr(torch.ops.torchvision, name):
            library.define(f"{name}(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")
    return pytest.importorskip("timm")


def _config(backbone, **changes):
    size = {"model.image_height_px": 120, "model.image_width_px": 160}
    return train_config("nano", {"model.backbone": backbone, **size, **changes}).model


class _Stages(nn.Module):
    """The stages of our own pathway, for images of any number of channels."""

    def __init__(self, pathway):
        super().__init__()
        self.stages = pathway.stages

    def forward(self, image):
        maps = [image[:, :1].expand(-1, 5 if self.stages[0][0][0].in_channels == 5 else 3, -1, -1)]
        for stage in self.stages:
            maps.append(stage(maps[-1]))
        return maps[1:]


@pytest.mark.parametrize("name", ["paper", "compact", "nano"])
def test_measured_lattices_of_our_own_trunks_are_those_that_the_layers_tell(name):
    pathway = ImagePathway(MODELS[name].model_copy(update={"image_channels": (8, 8, 8, 8)}))
    assert measured_lattices(_Stages(pathway), 360, 480) == pathway.lattices


@pytest.mark.parametrize(
    ("kernel", "padding", "offset"), [(3, 1, 0.5), (3, 0, 1.5), (4, 1, 1.0), (7, 3, 0.5), (1, 0, 0.5)]
)
def test_a_measured_lattice_is_that_of_the_formula(kernel, padding, offset):
    class Trunk(nn.Module):
        def __init__(self):
            super().__init__()
            self.layer = nn.Conv2d(3, 2, kernel, stride=2, padding=padding)

        def forward(self, image):
            features = self.layer(image)
            # A gate that sees the whole image, as in squeeze and excitation.
            return [features * features.mean((2, 3), keepdim=True).sigmoid()]

    trunk = Trunk()
    (lattice,) = measured_lattices(trunk, 64, 96)
    assert lattice == lattice_after([trunk.layer], PIXELS) == (2, offset)


@pytest.mark.parametrize(
    ("name", "offsets"),
    [
        ("resnet18", (0.5, 0.5, 0.5, 0.5)),  # odd kernels, padded by half their size
        ("mobilenetv3_small_100", (0.5, 0.5, 0.5, 0.5)),  # gates over the whole image
    ],
)
def test_lattices_of_known_networks(timm, name, offsets):
    pathway = TimmPathway(_config(f"timm:{name}"))
    assert [tuple(lattice) for lattice in pathway.lattices] == list(zip((2, 4, 8, 16), offsets, strict=True))
    with torch.no_grad():
        maps = pathway.eval()(torch.rand(1, 3, 120, 160))
    assert [tuple(features.shape[2:]) for features in maps] == pathway.sizes(120, 160)
    assert tuple(features.shape[1] for features in maps) == pathway.channels


@pytest.mark.thorough
def test_a_file_gives_timms_vgg16_the_features_of_our_own(timm, tmp_path):
    """Two implementations, of the network and of reading its weights."""
    torch.manual_seed(0)
    whole = timm.create_model("vgg16_bn", pretrained=False, num_classes=10)
    for module in whole.modules():
        if isinstance(module, nn.BatchNorm2d):
            nn.init.normal_(module.running_mean, std=0.1)
            nn.init.uniform_(module.running_var, 0.5, 1.5)
    features = {name: value for name, value in whole.state_dict().items() if name.startswith("features.")}
    torch.save(features, tmp_path / "ours.pth")
    save_file(whole.state_dict(), tmp_path / "theirs.safetensors")
    theirs = LaneNet(_config("timm:vgg16_bn")).eval()
    ours = LaneNet(PAPER.model_copy(update={"image_height_px": 64, "image_width_px": 64})).eval()
    assert theirs.image.lattices == ours.image.lattices
    load_pretrained(ours, str(tmp_path / "ours.pth"))
    assert load_pretrained(theirs, str(tmp_path / "theirs.safetensors")) == "vgg16_bn from theirs.safetensors"
    image = torch.rand(1, 3, 64, 64)
    with torch.no_grad():
        for mine, its in zip(ours.image(image), theirs.image(image), strict=True):
            assert its.std() > 1e-3
            torch.testing.assert_close(mine, its, rtol=1e-3, atol=1e-5)


def test_a_network_around_a_trunk_learns_and_its_checkpoint_rebuilds_it(timm):
    config = _config("timm:resnet18")
    torch.manual_seed(0)
    model = LaneNet(config)
    image, intrinsics = torch.rand(2, 3, 120, 160), torch.tensor([[138.6, 138.6, 80.0, 60.0]] * 2)
    output = model(image, intrinsics)
    assert output.x_m.shape == (2, 3, 16, 6)
    (output.x_m.square().sum() + output.pose.sum()).backward()
    assert model.image.trunk.conv1.weight.grad.abs().max() > 0
    again = LaneNet(type(config).model_validate_json(config.model_dump_json()))
    again.load_state_dict(model.state_dict())
    with torch.no_grad():
        assert again.eval()(image, intrinsics).x_m.equal(model.eval()(image, intrinsics).x_m)
    early = LaneNet(_config("timm:resnet18", **{"model.variant": "early_ipm", "model.pose_target": "fixed"}))
    assert len(early.image.channels) == 1
    assert early(image, intrinsics).x_m.isfinite().all()


def test_wrong_trunks_and_files_are_refused(timm, tmp_path):
    with pytest.raises(InputError, match=r"model\.backbone: expected a network of timm, got resnet19"):
        LaneNet(_config("timm:resnet19"))
    with pytest.raises(
        InputError, match=r"expected a network with maps at strides 2, 4, 8, 16, got .* of convnext_atto"
    ):
        LaneNet(_config("timm:convnext_atto"))
    with pytest.raises(InputError, match=r"train\.model\.backbone: expected text of the form \^\(vgg16"):
        _config("resnet18")
    still = {"augmentation.top_shift_m": 0, "augmentation.top_yaw_deg": 0}
    with pytest.raises(InputError, match=r"train\.model\.backbone: expected vgg16 or residual for image_view"):
        _config("timm:resnet18", **{"model.variant": "image_view", **still})
    model = LaneNet(_config("timm:resnet18"))
    for other in ("resnet34", "resnet10t"):
        torch.save(timm.create_model(other, pretrained=False).state_dict(), tmp_path / f"{other}.pth")
        with pytest.raises(FormatError, match=rf"{other}\.pth: .*: expected shape .* for resnet18, got"):
            load_pretrained(model, str(tmp_path / f"{other}.pth"))
    other_classes = timm.create_model("resnet18", pretrained=False, num_classes=7).state_dict()
    torch.save(other_classes, tmp_path / "seven.pth")
    load_pretrained(model, str(tmp_path / "seven.pth"))
    assert model.image.trunk.layer1[0].conv1.weight.equal(other_classes["layer1.0.conv1.weight"])
    (tmp_path / "bad.safetensors").write_bytes(b"x")
    with pytest.raises(FormatError, match=r"bad\.safetensors: expected a state dict"):
        load_pretrained(model, str(tmp_path / "bad.safetensors"))


def test_without_timm_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "timm", None)
    with pytest.raises(MissingPackageError, match="timm, which has resnet18, is not installed: pip install timm"):
        LaneNet(_config("timm:resnet18"))


def test_a_timm_that_cannot_be_imported_is_told_in_a_line(monkeypatch, tmp_path):
    (tmp_path / "timm.py").write_text('raise RuntimeError("operator torchvision::nms does not exist")')
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "timm", raising=False)
    with pytest.raises(MissingPackageError, match=r"timm, .*operator torchvision::nms .*: install torch"):
        LaneNet(_config("timm:resnet18"))
