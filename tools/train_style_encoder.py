"""Trains the encoder by which styled depth is judged without VGG-19: `train_style_encoder.py DATASET --out encoder.npz`.

DATASET is of `cabinpose synth --frames 160 --seed 71`. The encoder learns, from crops of its frames with noise of many kinds laid
on the clean depth, what each block of 8 x 8 pixels shows (conv4_4) and how noisy it is: σ, correlation length and losses
(conv2_2, conv3_4). Depth alone goes in. Prints the losses as it goes.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
import torch
from scipy import ndimage
from torch import nn
from torch.nn import functional

from cabinpose.scene.labels import LABELS
from cabinpose.store import open_dataset
from cabinpose.synth.style.encoder import OWN_WIDTHS, Encoder, shown

CROP, BATCH = 128, 8
CLASSES = {label.id: k for k, label in enumerate(LABELS)}


def noisy(clean: np.ndarray, *, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Clean depth (h, w) with random noise and losses: depth, valid, and (3,) log10 σ (mm), twice the correlation length
    (px), share of losses.
    """
    sigma, length, lost = 10 ** rng.uniform(-3.5, -1.3), rng.uniform(0, 1.5), rng.uniform(0, 1) ** 4 * 0.5
    noise = ndimage.gaussian_filter(rng.standard_normal(clean.shape), length)
    depth = clean + sigma * noise / noise.std()
    edges = ndimage.morphological_gradient(clean, 3) > 0.08 * clean
    ring = ndimage.binary_dilation(edges, iterations=rng.integers(1, 4)) if rng.random() < 0.6 else np.zeros_like(edges)
    valid = (clean > 0) & ~ring & (rng.random(clean.shape) >= lost)
    return np.where(valid, depth, 0), valid, np.array((np.log10(1e3 * sigma), 2 * length, lost))


def main() -> None:
    """Train and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--steps", type=int, default=1500)
    parser.add_argument("--seed", type=int, default=5)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(arguments.seed)
    rng = np.random.Generator(np.random.Philox(key=arguments.seed))
    data = open_dataset(arguments.dataset)
    depths, labels = np.nan_to_num(data["depth_clean"].values), data["labels"].values
    index = np.zeros(256, np.int64)
    for number, k in CLASSES.items():
        index[number] = k
    encoder = Encoder(OWN_WIDTHS)
    heads = nn.ModuleDict({"conv4_4": nn.Conv2d(OWN_WIDTHS[3], len(CLASSES), 1)})
    heads.update({name: nn.Conv2d(OWN_WIDTHS[k], 3, 1) for name, k in (("conv2_2", 1), ("conv3_4", 2))})
    parameters = [*encoder.parameters(), *heads.parameters()]
    for convolution in encoder.convolutions.values():
        nn.init.kaiming_normal_(convolution.weight)
        nn.init.zeros_(convolution.bias)
    optimiser = torch.optim.Adam(parameters, lr=1e-3)
    falling = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, arguments.steps)
    sums = np.zeros(4)
    for step in range(1, arguments.steps + 1):
        images, truths, classes = [], [], []
        for _ in range(BATCH):
            k = rng.integers(len(depths))
            y, x = (rng.integers(0, size - CROP + 1) for size in depths.shape[1:])
            at = (k, slice(y, y + CROP), slice(x, x + CROP))
            depth, valid, truth = noisy(depths[at], rng=rng)
            one = (torch.from_numpy(a.astype(np.float32))[None, None] for a in (depth, valid))
            images.append(shown(*one))
            truths.append(truth)
            classes.append(index[labels[at]][4::8, 4::8])
        features = encoder(torch.cat(images))
        wanted = torch.from_numpy(np.array(truths, np.float32))[..., None, None]
        guess = functional.cross_entropy(heads["conv4_4"](features["conv4_4"]), torch.from_numpy(np.array(classes)))
        noise = [functional.l1_loss(heads[name](features[name]), wanted.expand(-1, -1, *features[name].shape[2:]))
                 for name in ("conv2_2", "conv3_4")]  # fmt: skip
        right = (heads["conv4_4"](features["conv4_4"]).argmax(dim=1) == torch.from_numpy(np.array(classes))).float().mean()
        optimiser.zero_grad()
        (guess + sum(noise)).backward()
        optimiser.step()
        falling.step()
        sums += [float(guess), float(right), *map(float, noise)]
        if step % 100 == 0:
            print(
                step,
                json.dumps(dict(zip(("classes", "right", "conv2_2", "conv3_4"), (sums / 100).round(3), strict=True))),
                flush=True,
            )
            sums[:] = 0
    np.savez_compressed(arguments.out, **{name: value.numpy().astype(np.float16) for name, value in encoder.state_dict().items()})
    print(arguments.out, arguments.out.stat().st_size, "bytes")


if __name__ == "__main__":
    main()
