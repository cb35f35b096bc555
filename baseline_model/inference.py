"""Detect lanes in images with a trained network."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor, nn

from synth3dlanes.labels.labels import Labels
from synth3dlanes.system.errors import InputError

from .config import ModelConfig
from .curves import Pose
from .data import CameraImage, FocalLengths, Intrinsics, Samples, fit, pixels_on
from .devices import mixed_precision, return_freed_memory
from .lanes import Prediction, decode
from .loss import LaneDetector
from .model import LaneNet, Output
from .workers import ahead

Fitted = tuple[CameraImage, UInt8[np.ndarray, "rows columns 3"], Intrinsics]
"""An image, and what the network sees of it."""
BATCH = 16
MOST_BYTES = 1 << 26
"""Most bytes that the images of a batch take as read."""


def predictions_of(keys: Sequence[str], output: Output, model: ModelConfig) -> Iterator[Prediction]:
    """Decode a batch."""
    x_m, z_m, poses = (value.double().cpu().numpy() for value in (output.x_m, output.z_m, output.pose))
    scores = output.logit.double().sigmoid().cpu().numpy()
    logit = output.visible_logit
    seen = [None] * len(keys) if logit is None else logit.double().sigmoid().cpu().numpy()
    for i, key in enumerate(keys):
        pose = Pose(float(poses[i, 0]), float(poses[i, 1]))
        yield Prediction(key, decode(x_m[i], z_m[i], scores[i], pose, model, seen[i]), pose)


@torch.inference_mode()
def run(model: LaneNet, images: Float[Tensor, "b 3 h w"], intrinsics: Float[Tensor, "b 4"]) -> Output:
    """One forward pass without gradients; in float32 on CPUs, so that all CPUs give the same lanes."""
    with mixed_precision(images.device, "auto" if images.device.type == "cuda" else "float32"):
        output: Output = model(images, intrinsics)
    return output


@dataclass(frozen=True, eq=False)
class Detector:
    """A trained network, ours or a user's; the (height, width) of its input images; and the focal lengths that it was
    trained on, if known."""

    network: nn.Module
    size_px: tuple[int, int]
    trained: FocalLengths | None = None

    @property
    def device(self) -> torch.device:
        """Where the network is."""
        return next(self.network.parameters()).device

    @torch.inference_mode()
    def in_batch(
        self, keys: Sequence[str], image: UInt8[Tensor, "b 3 h w"], intrinsics: Float[Tensor, "b 4"]
    ) -> list[Prediction]:
        """The lanes of images of the network's size."""
        pixels, intrinsics = pixels_on(self.device, image), intrinsics.to(self.device)
        if isinstance(self.network, LaneNet):
            return list(predictions_of(keys, run(self.network, pixels, intrinsics), self.network.config))
        found = cast(LaneDetector, self.network).detect(pixels, intrinsics)
        return [Prediction(key, tuple(lanes), None) for key, lanes in zip(keys, found, strict=True)]

    def in_images(self, images: Iterable[CameraImage]) -> Iterator[tuple[CameraImage, Prediction]]:
        """Each image with its lanes. A thread reads and resizes the next images meanwhile."""

        def fitted(one: CameraImage) -> Fitted:
            try:
                found = fit(one.image, one.intrinsics, self.size_px, self.trained)
            except InputError as error:
                raise InputError(f"{one.key}: {error}") from None
            if one.image.nbytes > MOST_BYTES:
                return_freed_memory()
            return (one, *found)

        for several in _batched(ahead(map(fitted, images), 2)):
            of_batch, small, intrinsics = zip(*several, strict=True)
            pixels = torch.from_numpy(np.stack(small)).permute(0, 3, 1, 2)
            found = self.in_batch([one.key for one in of_batch], pixels, torch.tensor(intrinsics))
            yield from zip(of_batch, found, strict=True)

    def in_samples(
        self, samples: Samples, batch: int = BATCH, workers: int | None = None
    ) -> Iterator[tuple[Labels, Prediction]]:
        """The lanes of labelled images, of whose labels only the intrinsics are used, with these labels. Worker
        processes decode the images; None means one for each spare core."""
        # It reads data sets: these modules take longer to import than a photograph takes.
        from .loading import labelled_batches

        for several in labelled_batches(samples, self.size_px, self.trained, batch, workers, self.device):
            yield from zip(several.labels, self.in_batch(several.keys, several.image, several.intrinsics), strict=True)


def _batched(items: Iterable[Fitted]) -> Iterator[list[Fitted]]:
    """Batches of BATCH, or of fewer where images are large: as read, one may take 200 MB."""
    batch: list[Fitted] = []
    for item in items:
        batch.append(item)
        if len(batch) == BATCH or sum(one.image.nbytes for one, _, _ in batch) > MOST_BYTES:
            yield batch
            batch = []
    if batch:
        yield batch
