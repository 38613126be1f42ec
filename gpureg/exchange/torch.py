"""Tensors of PyTorch."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from . import warp
from .libraries import Memory, Place, on_cuda, refuse_gradients


def to_host(tensor: Any, name: str) -> npt.NDArray[Any]:
    """Return a view of a tensor on the CPU, a copy of one elsewhere; bfloat16 and narrower types as float32."""
    _expect_values(tensor, name)
    # copied on the current stream of the device, and waited for
    found: npt.NDArray[Any] = (tensor.float() if _lacks(tensor.dtype) else tensor).numpy(force=True)
    return found


def _expect_values(tensor: Any, name: str) -> None:
    """Raise a TypeError for a tensor that records gradients, or has no dense values."""
    import torch

    if tensor.requires_grad:
        refuse_gradients(name, f"{name}.detach()")
    if tensor.layout is not torch.strided:
        raise TypeError(f"{name} is a tensor of layout {tensor.layout}: pass {name}.to_dense()")
    if tensor.device.type == "meta":
        raise TypeError(f"{name} is a tensor on the device 'meta', which has no values")


def to_library(value: npt.NDArray[Any], like: Any) -> Any:
    """Return a tensor on the device of `like`; float32 as the type of `like` if numpy has not this type."""
    import torch

    narrow = _lacks(like.dtype) and value.dtype == np.float32
    if like.device.type == "mps" and value.dtype == np.float64:
        # Apple's GPUs have no float64
        value = value.astype(np.float32)
    return torch.from_numpy(value).to(device=like.device, dtype=like.dtype if narrow else None)


def to_warp(tensor: Any, name: str) -> Memory | None:
    """Return the memory of a tensor on a CUDA device."""
    _expect_values(tensor, name)
    return warp.memory_of(tensor) if tensor.device.type == "cuda" else None


def from_warp(numbers: Any, shape: tuple[int, ...], like: Any) -> Any:
    """Return a tensor; its current stream waits for that of Warp."""
    import torch

    return torch.from_dlpack(numbers).reshape(shape)


def place(tensor: Any) -> Place | None:
    """Return the CUDA device of a tensor."""
    return on_cuda(tensor) if tensor.device.type == "cuda" else None


def _lacks(dtype: Any) -> bool:
    """Return whether numpy lacks a floating-point type, such as bfloat16."""
    import torch

    return bool(dtype.is_floating_point) and dtype not in (torch.float16, torch.float32, torch.float64)
