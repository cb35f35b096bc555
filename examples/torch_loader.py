"""A PyTorch loader with augmentation: mirrored scenes, and images of another brightness.

The labels of a mirrored image are exact, too: its camera looks into a mirrored world.
"""

import argparse

import numpy as np
import torch
from torch.utils.data import DataLoader, Dataset

import synth3dlanes as s3d


class Lanes(Dataset):
    """A split. Each item is an image (3, h, w) from 0 to 1, K (3, 3), and the centre lines as (n, 3) points in metres
    in the camera frame: x right, y forward, z up."""

    def __init__(self, place: str, seed: int = 0) -> None:
        self.reader = s3d.open_dataset(place)
        self.seed, self.epoch = seed, 0

    def __len__(self) -> int:
        return len(self.reader)

    def __getitem__(self, i: int) -> tuple[torch.Tensor, torch.Tensor, list[torch.Tensor]]:
        sample = self.reader[i]
        lines = [lane.xyz_cam[lane.visible] for lane in sample.labels.lanes if lane.kind == "centerline"]
        image, k = sample.image / np.float32(255), sample.labels.camera.img_from_cam.copy()
        # A stream for each item and epoch: equal seeds give equal batches, whatever the number of workers.
        rng = np.random.default_rng((self.seed, self.epoch, i))
        if rng.random() < 0.5:
            image, lines = image[:, ::-1], [line * (-1, 1, 1) for line in lines]
            # u becomes width - u, and x its opposite.
            k[0] = image.shape[1] * k[2] - k[0]
            k[:, 0] *= -1
        image = np.clip(image * rng.uniform(0.7, 1.3), 0, 1)
        tensor = torch.from_numpy(np.ascontiguousarray(image, np.float32)).permute(2, 0, 1)
        return tensor, torch.from_numpy(k), [torch.from_numpy(line.astype(np.float32)) for line in lines]


def collate(items: list) -> tuple[torch.Tensor, torch.Tensor, list]:
    """Images and Ks stacked; scenes have different numbers of lines, which stay a list."""
    images, ks, lines = zip(*items, strict=True)
    return torch.stack(images), torch.stack(ks), list(lines)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", help="data set made by synth3dlanes generate, with a split `train`")
    parser.add_argument("--batch", type=int, default=8)
    arguments = parser.parse_args()
    for images, ks, lines in DataLoader(Lanes(arguments.data), arguments.batch, shuffle=True, collate_fn=collate):
        print(tuple(images.shape), tuple(ks.shape), [len(one) for one in lines])
