"""Training of a region's network with PyTorch, which is needed for nothing else."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import torch
from torch import Tensor, nn

from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.head.dense.network import (
    CHANNELS,
    HIDDEN,
    KERNELS,
    LEAST_CONTRAST,
    LEAST_SD,
    POSITION_SCALE,
)
from research.face_dense.samples import Samples

BATCH, EPOCHS, GAZE_EPOCHS, RATE = 128, 24, 40, 2.5e-3
FLAT_EPOCHS = 4
"""First epochs, in which standard deviations are not learned yet."""


def layers(height: int, width: int, outputs: int) -> nn.Sequential:
    """Return an untrained network."""
    stages: list[nn.Module] = []
    before = 1
    for channels, kernel in zip(CHANNELS, KERNELS, strict=True):
        stages += [nn.Conv2d(before, channels, kernel, 2, kernel // 2), nn.ReLU()]
        height, width, before = (height + 1) // 2, (width + 1) // 2, channels
    flat = height * width * before
    return nn.Sequential(
        *stages, nn.Flatten(), nn.Linear(flat, HIDDEN), nn.ReLU(), nn.Linear(HIDDEN, outputs)
    )


def normalised(crops: Tensor) -> Tensor:
    """Return crops (N, 1, height, width) of mean 0 and standard deviation 1."""
    grey = crops.float()
    mean, sd = grey.mean((2, 3), keepdim=True), grey.std((2, 3), keepdim=True, correction=0)
    return (grey - mean) / (sd + LEAST_CONTRAST)


def _varied(crops: Tensor, generator: torch.Generator) -> Tensor:
    """Return crops with other brightness curves, blur-free noise and covered parts."""
    count = len(crops)
    bend = torch.empty(count, 1, 1, 1).uniform_(-0.35, 0.35, generator=generator)
    grey = crops.float() / 255.0
    grey = grey + bend * grey * (1.0 - grey) * 2.0
    height, width = grey.shape[2:]
    y, x = torch.arange(height).view(1, 1, -1, 1), torch.arange(width).view(1, 1, 1, -1)
    middle = torch.rand(count, 2, generator=generator)
    radius = torch.empty(count, 1, 1, 1).uniform_(0.03, 0.14, generator=generator) * width
    chosen = torch.rand(count, 1, 1, 1, generator=generator) < 0.12
    covered = ((y - middle[:, :1, None, None] * height).abs() < radius) & (
        (x - middle[:, 1:, None, None] * width).abs() < radius
    )
    shade = torch.rand(count, 1, 1, 1, generator=generator)
    return torch.where(covered & chosen, shade, grey) * 255.0


class Objective:
    """Negative log-likelihood of targets under Laplace distributions.

    Args:
        pairs: pairs of points whose distance matters, such as upper and lower lid.
        points: number of points.
    """

    def __init__(self, pairs: Sequence[tuple[int, int]], points: int) -> None:
        self._first, self._second = (torch.tensor([pair[side] for pair in pairs]) for side in (0, 1))
        self._points = points

    def __call__(self, out: Tensor, targets: Tensor, *, flat: bool) -> Tensor:
        """Return the mean loss; with ``flat``, deviations have no influence."""
        count = self._points
        places, logs = out[:, : 3 * count].view(-1, count, 3), out[:, 3 * count : 4 * count]
        error = (places - targets).abs()
        planar = error[..., :2].sum(-1)
        spread = torch.exp(logs) + LEAST_SD
        fit = planar.mean() if flat else (planar / spread + 2.0 * torch.log(spread)).mean() / 3.0
        gap = (places[:, self._first] - places[:, self._second]) - (
            targets[:, self._first] - targets[:, self._second]
        )
        total = fit + planar.mean() + 0.1 * error[..., 2].mean() + 1.0 * gap[..., :2].abs().sum(-1).mean()
        if flat:
            total = total + 0.1 * (logs + 2.0).square().mean()
        return total


def gaze_loss(out: Tensor, gazes: Tensor, *, flat: bool) -> Tensor:
    """Return the mean loss of gazes; with ``flat``, deviations have no influence."""
    error = (out[:, :2] - gazes).abs().sum(-1)
    if flat:
        return 2.0 * error.mean() + 0.1 * (out[:, 2] + 2.0).square().mean()
    spread = torch.exp(out[:, 2]) + LEAST_SD
    return 0.5 * (error / spread + 2.0 * torch.log(spread)).mean() + error.mean()


@dataclass(frozen=True, eq=False)
class Trained:
    """A trained network and the mean places (P, 3) that its outputs are relative to."""

    layers: nn.Sequential
    middle: FloatArray


def train(
    samples: Samples, pairs: Sequence[tuple[int, int]], mirrored: Sequence[int] | None, seed: int
) -> Trained:
    """Train a network.

    Args:
        samples: of the region.
        pairs: see ``Objective``.
        mirrored: for a symmetric region, index of each point's mirror image; its mirrored crops are used too.
        seed: of weights and order.
    """
    width = samples.crops.shape[2]
    middle = samples.targets.mean(axis=0).astype(np.float64)
    if mirrored is not None:
        middle = 0.5 * (middle + _mirror(torch.from_numpy(middle), mirrored, width - 1.0).numpy())
    objective, targets = Objective(pairs, len(middle)), torch.from_numpy(samples.targets)
    offset = torch.from_numpy(middle.astype(np.float32))

    def loss(net: nn.Module, seen: Tensor, chosen: Tensor, generator: torch.Generator, flat: bool) -> Tensor:
        places = targets[chosen]
        if mirrored is not None and torch.rand(1, generator=generator) < 0.5:
            seen, places = seen.flip(3), _mirror(places, mirrored, width - 1.0)
        return objective(net(_inputs(seen, generator)), (places - offset) / POSITION_SCALE, flat=flat)

    return Trained(_fitted(samples.crops, 4 * len(middle), loss, EPOCHS, seed), middle)


def train_gaze(crops: ImageArray, gazes: FloatArray, seed: int) -> Trained:
    """Train the network of gazes (N, 2), rad, in crops (N, height, width)."""
    wanted = torch.from_numpy(gazes.astype(np.float32))

    def loss(net: nn.Module, seen: Tensor, chosen: Tensor, generator: torch.Generator, flat: bool) -> Tensor:
        return gaze_loss(net(_inputs(seen, generator)), wanted[chosen], flat=flat)

    return Trained(_fitted(crops, 3, loss, GAZE_EPOCHS, seed), np.zeros((0, 3)))


def _inputs(crops: Tensor, generator: torch.Generator) -> Tensor:
    return normalised(_varied(crops, generator)).contiguous(memory_format=torch.channels_last)


Loss: TypeAlias = Callable[[nn.Module, Tensor, Tensor, torch.Generator, bool], Tensor]
"""Loss of a network for crops (B, 1, height, width) of chosen samples (B,)."""


def _fitted(crops: ImageArray, outputs: int, loss: Loss, epochs: int, seed: int) -> nn.Sequential:
    """Return a network trained on crops (N, height, width); ``seed`` is that of weights and order."""
    torch.manual_seed(seed)
    torch.set_num_threads(1)
    generator = torch.Generator().manual_seed(seed)
    net = layers(crops.shape[1], crops.shape[2], outputs).to(memory_format=torch.channels_last)
    optimiser = torch.optim.AdamW(net.parameters(), RATE, weight_decay=1e-4)
    steps = len(crops) // BATCH * epochs
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, RATE, total_steps=steps, pct_start=0.15)
    images = torch.from_numpy(crops)[:, None]
    for epoch in range(epochs):
        total = 0.0
        for chosen in torch.randperm(len(crops), generator=generator)[: steps // epochs * BATCH].split(BATCH):
            step = loss(net, images[chosen], chosen, generator, epoch < FLAT_EPOCHS)
            optimiser.zero_grad()
            step.backward()
            optimiser.step()
            schedule.step()
            total += step.item()
        print(f"epoch {epoch + 1}: {total / (steps // epochs):.4f}", flush=True)
    return net.eval()


def _mirror(places: Tensor, mirrored: Sequence[int], right: float) -> Tensor:
    """Return places (..., P, 3) in a crop whose columns are reversed; ``right`` is the last column."""
    turned = places[..., list(mirrored), :].clone()
    turned[..., 0] = right - turned[..., 0]
    return turned


def weights_of(trained: Trained, checked: ImageArray) -> dict[str, FloatArray]:
    """Return the arrays of a network as ``head.dense.network`` reads them, but for ``spread``.

    Args:
        trained: the network.
        checked: (N, height, width) crops of its region.
    """
    arrays: dict[str, FloatArray] = {"middle": trained.middle}
    full = 0
    shape = checked.shape[1:]
    for number, layer in enumerate(one for one in trained.layers if isinstance(one, (nn.Conv2d, nn.Linear))):
        weights, bias = layer.weight.detach().numpy(), layer.bias.detach().numpy()
        if isinstance(layer, nn.Conv2d):
            name, weights = f"convolution{number}", weights.transpose(2, 3, 1, 0)
            shape, channels = tuple((side + 1) // 2 for side in shape), len(bias)
        else:
            name, weights = f"full{full}", weights.T
            if full == 0:  # from the order channel, y, x to y, x, channel
                weights = weights.reshape(channels, *shape, -1).transpose(1, 2, 0, 3).reshape(weights.shape)
            full += 1
        arrays |= {f"{name}.weights": weights.astype(np.float16), f"{name}.bias": bias.astype(np.float32)}
    return arrays


def spread_of(trained: Trained, checked: Samples) -> FloatArray:
    """Return the factors (P,) by which stated deviations match the errors on samples of other people."""
    out, count = outputs_of(trained, checked.crops), len(trained.middle)
    places = out[:, : 3 * count].reshape(-1, count, 3) * POSITION_SCALE + trained.middle
    stated = (np.exp(out[:, 3 * count : 4 * count]) + LEAST_SD) * POSITION_SCALE
    errors = np.abs((places - checked.targets)[..., :2]).max(axis=-1) / stated
    # the larger of two normal errors exceeds 1.95 deviations in a tenth of the samples
    factors: FloatArray = np.quantile(errors, 0.9, axis=0) / 1.95
    return factors


def gaze_spread(trained: Trained, crops: ImageArray, gazes: FloatArray) -> FloatArray:
    """Return the factor (1,) by which stated deviations match the errors on gazes of other people."""
    out = outputs_of(trained, crops)
    errors = np.abs(out[:, :2] - gazes).max(axis=1) / (np.exp(out[:, 2]) + LEAST_SD)
    return np.array([np.quantile(errors, 0.9) / 1.95])


def outputs_of(trained: Trained, crops: ImageArray) -> FloatArray:
    """Return the outputs (N, outputs) for crops."""
    with torch.no_grad():
        out: FloatArray = trained.layers(normalised(torch.from_numpy(crops)[:, None])).numpy()
    return out.astype(np.float64)
