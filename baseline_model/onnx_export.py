"""Export a network to ONNX: inputs `image` (RGB in 0..1) and `intrinsics`, named outputs, any batch size."""

import warnings
from collections.abc import Iterator
from itertools import chain, islice
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from synth3dlanes.system.errors import MissingPackageError
from synth3dlanes.system.files import write

from . import checkpoint as checkpoints
from .config import ModelConfig
from .data import CameraImage
from .model import LaneNet, Output
from .pictures import open_pictures

OPSET = 18
INPUTS = ("image", "intrinsics")
OUTPUTS = ("x_m", "z_m", "score", "pose", "visibility")
"""`visibility` only for networks that predict it. `onnx_decode.py` makes lanes from them."""


class _Plain(nn.Module):
    """The network with the outputs that are exported."""

    def __init__(self, model: LaneNet) -> None:
        super().__init__()
        self.model = model

    def forward(self, image: Float[Tensor, "b 3 h w"], intrinsics: Float[Tensor, "b 4"]) -> tuple[Tensor, ...]:
        """The tensors named in OUTPUTS."""
        return plain(self.model, self.model(image, intrinsics))


def plain(model: LaneNet, output: Output) -> tuple[Tensor, ...]:
    """The tensors named in OUTPUTS: probabilities instead of logits, and x in the road frame, not relative to the
    anchor."""
    x_m = output.x_m + model.anchors_m[:, None]
    values = (x_m, output.z_m, output.logit.sigmoid(), output.pose)
    return values if output.visible_logit is None else (*values, output.visible_logit.sigmoid())


def metadata_of(config: ModelConfig) -> dict[str, str]:
    """What a decoder of the outputs needs to know."""
    return {
        "config": config.model_dump_json(),
        "types": ",".join(config.types),
        "knots_y_m": str(list(config.knots_y_m)),
    }


def export_onnx(checkpoint: str | Path, path: str | Path, calibration: str | Path | None = None) -> Path:
    """Export the checkpoint's network; its metadata has the knots' y, the types and the whole configuration.

    `calibration` is a split or a folder of images, by which the convolutions become int8 (`onnx_int8.quantised`).
    """
    loaded, model = checkpoints.load_lane_net(checkpoint, torch.device("cpu"))
    images: Iterator[CameraImage] = iter(()) if calibration is None else open_pictures(calibration, None).images
    # Read before the export, which takes half a minute.
    first = list(islice(images, 1))
    target, proto = Path(path), exported(model)
    if calibration is not None:
        from .onnx_int8 import quantised

        proto = quantised(proto, chain(first, images), checkpoints.detector_of(loaded, model))
    onnx = _onnx()
    onnx.helper.set_model_props(proto, metadata_of(model.config))
    write(target, proto.SerializeToString())
    return target


def exported(model: LaneNet) -> Any:
    """The network as ONNX's ModelProto."""
    _onnx()
    config = model.config
    # A batch of two: the exporter would treat a size of one as constant.
    image = torch.zeros(2, 3, config.image_height_px, config.image_width_px)
    intrinsics = torch.tensor([config.reference_intrinsics] * 2)
    batch = torch.export.Dim("batch", min=1)
    with warnings.catch_warnings():
        # It tells of its own ways: names of axes, and what torch is about to give up.
        warnings.simplefilter("ignore")
        program: Any = torch.onnx.export(
            _Plain(model).eval(),
            (image, intrinsics),
            input_names=INPUTS,
            output_names=OUTPUTS if config.has_visibility else OUTPUTS[:-1],
            opset_version=OPSET,
            dynamo=True,
            dynamic_shapes={"image": {0: batch}, "intrinsics": {0: batch}},
            verbose=False,
        )
    return program.model_proto


def _onnx() -> Any:
    try:
        import onnx  # type: ignore[import-not-found,import-untyped,unused-ignore]
    except ImportError:
        raise MissingPackageError("onnx and onnxscript are not installed: pip install onnx onnxscript") from None
    return onnx
