"""Activations that are the same functions as torch's, and faster on a CPU."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn


class _Elu(torch.autograd.Function):
    """max(x, exp(min(x, 0)) - 1), in one array."""

    # With setup_context in a function of its own, torch would look at the signature anew in every call.
    @staticmethod
    def forward(ctx: Any, input: Tensor) -> Tensor:
        output = input.clamp(max=0.0).exp_().sub_(1.0)
        torch.maximum(input, output, out=output)
        ctx.save_for_backward(output)
        return output

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> Tensor:
        (output,) = ctx.saved_tensors
        return torch.ops.aten.elu_backward(gradients[0], 1.0, 1.0, 1.0, True, output)


class ELU(nn.Module):
    """x above 0, exp(x) - 1 below (Clevert, Unterthiner and Hochreiter, 2016).

    Torch's own computes expm1, which takes a CPU longer than exp and is exact where the result is tiny; here the result
    is within 1e-7 of it.
    """

    def forward(self, input: Tensor) -> Tensor:
        """Of any shape."""
        if input.is_cpu and input.dtype == torch.float32:
            return _Elu.apply(input)
        return nn.functional.elu(input)
