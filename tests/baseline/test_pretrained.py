"""Weights of a VGG16 from files of both known forms."""

import itertools

import pytest
import torch


def test_vgg16_weights_from_files(tmp_path):
    import h5py
    from synth3dlanes_baseline.backbone import IMAGE_STD, ImagePathway
    from synth3dlanes_baseline.config import PAPER
    from synth3dlanes_baseline.pretrained import load_vgg16

    from synth3dlanes.errors import FormatError, InputError

    channels = [3, 64, 64, 128, 128, 256, 256, 256, 512, 512, 512, 512, 512, 512]
    generator = torch.Generator().manual_seed(0)
    layers = [
        (torch.randn(o, i, 3, 3, generator=generator), torch.randn(o, generator=generator))
        for i, o in itertools.pairwise(channels)
    ]
    state = {f"features.{2 * n}.{part}": value for n, layer in enumerate(layers)
             for part, value in zip(("weight", "bias"), layer, strict=True)}  # fmt: skip
    torch.save(state, tmp_path / "vgg16.pth")
    for batch_norm in (False, True):
        image = ImagePathway(PAPER.model_copy(update={"batch_norm": batch_norm}))
        assert load_vgg16(image, str(tmp_path / "vgg16.pth")) == "13 convolutions from vgg16.pth"
        convolutions = [layer for layer in image.modules() if isinstance(layer, torch.nn.Conv2d)]
        assert all(layer.weight.equal(weight) for layer, (weight, _) in zip(convolutions, layers, strict=True))
        if not batch_norm:
            assert convolutions[5].bias.equal(layers[5][1])
    names = [f"block{b}/layers/conv2d{f'_{i}' if i else ''}/vars" for b, n in enumerate((2, 2, 3, 3, 3), 1)
             for i in range(n)]  # fmt: skip
    with h5py.File(tmp_path / "hed.h5", "w") as file:
        for name, (weight, bias) in zip(names, layers, strict=True):
            file[f"{name}/0"], file[f"{name}/1"] = weight.permute(2, 3, 1, 0).numpy(), bias.numpy()
    load_vgg16(image, str(tmp_path / "hed.h5"))
    # The file's first kernel is for BGR in 0..255; ours for RGB in 0..1 divided by the spread: equal responses.
    kernel = convolutions[0].weight
    blue_255 = layers[0][0][:, 0] * 255 * IMAGE_STD[2]
    assert torch.allclose(kernel[:, 2], blue_255)
    assert convolutions[7].weight.equal(layers[7][0])
    with pytest.raises(InputError, match="no such file"):
        load_vgg16(image, str(tmp_path / "none.pth"))
    (tmp_path / "bad.pth").write_bytes(b"x")
    with pytest.raises(FormatError, match=r"bad\.pth: expected a state dict"):
        load_vgg16(image, str(tmp_path / "bad.pth"))
