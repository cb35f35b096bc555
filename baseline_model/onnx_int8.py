"""Quantise an exported network: int8 weights and activations of its convolutions, by ONNX Runtime's own tools."""

import logging
from collections.abc import Iterable, Iterator
from itertools import islice
from typing import Any

import numpy as np

from synth3dlanes.system.errors import MissingPackageError
from synth3dlanes.system.scratch import scratch

from .data import CameraImage, fit
from .inference import Detector

CALIBRATED = 32
"""Images whose activations give the ranges."""


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
