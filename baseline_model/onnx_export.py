"""Export a network to ONNX: inputs `image` (RGB in 0..1) and `intrinsics`, named outputs, any batch size; with int8
convolutions if images give the ranges of activations.
"""

import logging
import warnings
from collections.abc import Iterable, Iterator
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from synth3dlanes.system.errors import MissingPackageError
from synth3dlanes.system.files import write
from synth3dlanes.system.scratch import scratch

from . import checkpoint as checkpoints
from .config import ModelConfig
from .data import CameraImage, fit
from .inference import Detector
from .model import LaneNet, Output
from .predict import open_pictures

OPSET = 18
INPUTS = ("image", "intrinsics")
OUTPUTS = ("x_m", "z_m", "score", "pose", "visibility")
"""`visibility` only for networks that predict it. `onnx_decode.py` makes lanes from them."""
CALIBRATED = 32
"""Images whose activations give the ranges."""


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

    `calibration` is a split or a folder of images, by which the convolutions become int8 (`quantised`).
    """
    loaded, model = checkpoints.load_lane_net(checkpoint, torch.device("cpu"))
    images: Iterator[CameraImage] = iter(()) if calibration is None else open_pictures(calibration, None).images
    # Read before the export, which takes half a minute.
    first = list(islice(images, 1))
    target, proto = Path(path), exported(model)
    if calibration is not None:
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
    image = torch.zeros(2, 3, *config.size_px)
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


def quantised(proto: Any, images: Iterable[CameraImage], detector: Detector) -> Any:
    """The model with convolutions in int8, a scale for each channel of a weight, and the ranges of activations from the
    first images. All else stays in float32: quantised too, it costs lanes (docs/baseline.md)."""
    try:
        import onnx
        from onnxruntime.quantization import (  # type: ignore[import-untyped,import-not-found,unused-ignore]
            CalibrationDataReader,
            QuantFormat,
            QuantType,
            quantize_static,
        )
    except ImportError:
        raise MissingPackageError("onnxruntime is not installed: pip install onnxruntime") from None

    def inputs() -> Iterator[dict[str, Any]]:
        for one in islice(images, CALIBRATED):
            pixels, intrinsics = fit(one.image, one.intrinsics, detector.size_px, detector.trained)
            image = (pixels.transpose(2, 0, 1)[None] / 255).astype(np.float32)
            yield {"image": image, "intrinsics": np.array([intrinsics], dtype=np.float32)}

    class Calibration(CalibrationDataReader):  # type: ignore[misc, unused-ignore]
        def __init__(self) -> None:
            self.rest = inputs()

        def get_next(self) -> dict[str, Any] | None:
            return next(self.rest, None)

    with scratch() as folder:
        target = folder / "int8.onnx"
        # It advises to fold batch norm first, which the exporter has done.
        logging.disable(logging.WARNING)
        try:
            quantize_static(
                proto,
                str(target),
                Calibration(),
                quant_format=QuantFormat.QDQ,
                op_types_to_quantize=["Conv"],
                per_channel=True,
                activation_type=QuantType.QUInt8,
                weight_type=QuantType.QInt8,
            )
        finally:
            logging.disable(logging.NOTSET)
        return onnx.load(target)
