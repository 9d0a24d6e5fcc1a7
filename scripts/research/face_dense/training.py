"""Training of a region's network with PyTorch, which is needed for nothing else."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from posetrack_cli.arrays import FloatArray
from posetrack_cli.head.dense.network import (
    CHANNELS,
    HIDDEN,
    KERNELS,
    LEAST_CONTRAST,
    LEAST_SD,
    POSITION_SCALE,
)
from research.face_dense.samples import Samples

BATCH, EPOCHS, RATE = 128, 24, 2.5e-3
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
        is_eye: whether the gaze is learned as well.
    """

    def __init__(self, pairs: Sequence[tuple[int, int]], points: int, *, is_eye: bool) -> None:
        self._first, self._second = (torch.tensor([pair[side] for pair in pairs]) for side in (0, 1))
        self._points, self._is_eye = points, is_eye

    def __call__(self, out: Tensor, targets: Tensor, gazes: Tensor, *, flat: bool) -> Tensor:
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
        if self._is_eye:
            total = total + self._gaze(out[:, 4 * count :], gazes, flat=flat)
        return total

    @staticmethod
    def _gaze(out: Tensor, gazes: Tensor, *, flat: bool) -> Tensor:
        error = (out[:, :2] - gazes).abs().sum(-1)
        spread = torch.exp(out[:, 2]) + LEAST_SD
        return 0.3 * (error.mean() if flat else (error / spread + 2.0 * torch.log(spread)).mean())


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
    torch.manual_seed(seed)
    torch.set_num_threads(1)
    generator = torch.Generator().manual_seed(seed)
    height, width = samples.crops.shape[1:]
    middle = samples.targets.mean(axis=0).astype(np.float64)
    if mirrored is not None:
        middle = 0.5 * (middle + _mirror(torch.from_numpy(middle), mirrored, width - 1.0).numpy())
    count, is_eye = len(middle), mirrored is None
    net = layers(height, width, 4 * count + (3 if is_eye else 0)).to(memory_format=torch.channels_last)
    objective = Objective(pairs, count, is_eye=is_eye)
    crops, targets = torch.from_numpy(samples.crops)[:, None], torch.from_numpy(samples.targets)
    gazes, offset = torch.from_numpy(samples.gazes), torch.from_numpy(middle.astype(np.float32))
    optimiser = torch.optim.AdamW(net.parameters(), RATE, weight_decay=1e-4)
    steps = len(crops) // BATCH * EPOCHS
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, RATE, total_steps=steps, pct_start=0.15)
    for epoch in range(EPOCHS):
        total = 0.0
        for chosen in torch.randperm(len(crops), generator=generator)[: steps // EPOCHS * BATCH].split(BATCH):
            seen, places = crops[chosen], targets[chosen]
            if mirrored is not None and torch.rand(1, generator=generator) < 0.5:
                seen, places = seen.flip(3), _mirror(places, mirrored, width - 1.0)
            seen = normalised(_varied(seen, generator)).contiguous(memory_format=torch.channels_last)
            wanted = (places - offset) / POSITION_SCALE
            loss = objective(net(seen), wanted, gazes[chosen], flat=epoch < FLAT_EPOCHS)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            schedule.step()
            total += loss.item()
        print(f"epoch {epoch + 1}: {total / (steps // EPOCHS):.4f}", flush=True)
    return Trained(net.eval(), middle)


def _mirror(places: Tensor, mirrored: Sequence[int], right: float) -> Tensor:
    """Return places (..., P, 3) in a crop whose columns are reversed; ``right`` is the last column."""
    turned = places[..., list(mirrored), :].clone()
    turned[..., 0] = right - turned[..., 0]
    return turned


def weights_of(trained: Trained, checked: Samples) -> dict[str, FloatArray]:
    """Return the arrays of a network as ``head.dense.network`` reads them.

    Stated deviations are scaled so that they match the errors on samples of other people.
    """
    arrays: dict[str, FloatArray] = {"middle": trained.middle}
    full = 0
    shape = checked.crops.shape[1:]
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
    with torch.no_grad():
        out = trained.layers(normalised(torch.from_numpy(checked.crops)[:, None])).numpy()
    count = len(trained.middle)
    places = out[:, : 3 * count].reshape(-1, count, 3) * POSITION_SCALE + trained.middle
    stated = (np.exp(out[:, 3 * count : 4 * count]) + LEAST_SD) * POSITION_SCALE
    errors = np.abs((places - checked.targets)[..., :2]).max(axis=-1) / stated
    # the larger of two normal errors exceeds 1.95 deviations in a tenth of the samples
    arrays["spread"] = np.quantile(errors, 0.9, axis=0) / 1.95
    return arrays
