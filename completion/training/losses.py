"""Masked losses on log depth; each returns a scalar and ignores pixels without truth."""

import torch
import torch.nn.functional as F
from torch import Tensor

SCALES = 4  # of `gradient_matching`


def masked_mean(values: Tensor, valid: Tensor) -> Tensor:
    """Mean of `values` where `valid`; 0 where nothing is. Masked indexing would take a tenth of a training step."""
    return torch.where(valid, values, torch.zeros_like(values)).sum() / valid.sum().clamp_min(1)


def masked_l1(prediction: Tensor, target: Tensor, valid: Tensor) -> Tensor:
    """Mean absolute error over valid pixels (the paper's loss); inputs (B,1,H,W), valid boolean."""
    return masked_mean((prediction - target).abs(), valid)


def laplace_nll(prediction: Tensor, log_scale: Tensor, target: Tensor, valid: Tensor) -> Tensor:
    """Negative log likelihood of a Laplace distribution, |e| / b + log b; trains the predicted error b."""
    error = (prediction - target).abs()
    return masked_mean(error * torch.exp(-log_scale) + log_scale, valid)


def gradient_matching(prediction: Tensor, target: Tensor, valid: Tensor) -> Tensor:
    """Mean L1 of the error's horizontal and vertical differences at `SCALES` resolutions, each half the last.

    Keeps fold edges sharp and surfaces smooth where plain L1 is content with blur (MegaDepth, CVPR 2018).
    """
    error = torch.where(valid, prediction - target, torch.zeros_like(target))
    mask = valid.float()
    total = error.new_zeros(())
    for scale in range(SCALES):
        if scale:
            weight = F.avg_pool2d(mask, 2)
            error = F.avg_pool2d(error * mask, 2) / weight.clamp_min(1e-6)
            mask = (weight > 0.5).float()
        for axis in (2, 3):
            both = mask.narrow(axis, 1, mask.shape[axis] - 1) * mask.narrow(axis, 0, mask.shape[axis] - 1)
            total = total + (error.diff(dim=axis).abs() * both).sum() / both.sum().clamp_min(1)
    return total / SCALES


def completion_loss(log_depth: Tensor, log_scale: Tensor, target: Tensor, valid: Tensor) -> Tensor:
    """L1 + 0.1 Laplace NLL + 0.5 gradient matching on log depth (B,1,H,W), the loss of the shipped model."""
    return (
        masked_l1(log_depth, target, valid)
        + 0.1 * laplace_nll(log_depth, log_scale, target, valid)
        + 0.5 * gradient_matching(log_depth, target, valid)
    )
