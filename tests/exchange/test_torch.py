"""Tensors of PyTorch on the CPU; ``pip install torch`` brings the CUDA build, so that it is no dependency of a test."""

from __future__ import annotations

import numpy as np
import pytest
from test_arguments import IMAGE, ON

import gpureg as gr
from gpureg import exchange

torch = pytest.importorskip("torch", reason="PyTorch is not installed: tests/exchange/test_exchange.py stands for it")

IMAGES = {
    "as it is": lambda t: t,
    "transposed": lambda t: t.T,
    "every second": lambda t: t[1::2, ::3],
    "expanded": lambda t: t[:1].expand(24, -1),
    "conjugate": lambda t: torch.complex(t, t).conj().imag,
    "inference": lambda t: _in_inference(t),
}


def _in_inference(tensor):
    with torch.inference_mode():
        return tensor + 1


@pytest.mark.parametrize("layout", IMAGES)
def test_every_layout(layout):
    tensor = IMAGES[layout](torch.from_numpy(IMAGE))
    found = gr.denoise_tv(tensor, lam=0.3, max_iter=2, **ON)
    expected = gr.denoise_tv(tensor.resolve_neg().numpy(), lam=0.3, max_iter=2, **ON)
    assert type(found) is torch.Tensor and found.device.type == "cpu" and not found.requires_grad
    np.testing.assert_array_equal(found.numpy(), expected)


@pytest.mark.parametrize("dtype", ["float64", "float32", "float16", "bfloat16", "uint8", "int16", "uint16", "int32"])
def test_the_same_type_comes_back(dtype):
    tensor = torch.from_numpy(IMAGE).to(getattr(torch, dtype))
    assert gr.denoise_tv(tensor, lam=0.3, max_iter=2, **ON).dtype == tensor.dtype


def test_bfloat16_is_computed_as_float32():
    tensor = torch.from_numpy(IMAGE).to(torch.bfloat16)
    found = gr.denoise_tv(tensor, lam=0.3, max_iter=2, **ON)
    assert torch.equal(found, gr.denoise_tv(tensor.float(), lam=0.3, max_iter=2, **ON).to(torch.bfloat16))
    # weights, labels and the like have types of their own
    assert gr.energy_partition(tensor, gr.GridGraph((24, 26)), np.eye(24, 26, dtype=int) - 1, **ON).dtype == torch.int32


def test_nothing_is_copied():
    tensor = torch.from_numpy(IMAGE.copy())
    assert np.shares_memory(exchange.on_host(tensor, "x"), tensor.numpy())
    made: list = []
    from_numpy = torch.from_numpy
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(torch, "from_numpy", lambda x: made.append(x) or from_numpy(x))
        found = gr.regularize(tensor, gr.GridGraph(IMAGE.shape), max_iter=1, **ON).value
    assert found.data_ptr() == made[0].ctypes.data and found.data_ptr() != tensor.data_ptr()


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda t: t.clone().requires_grad_(), r"^denoise_tv: image requires gradients, .*pass image\.detach\(\)$"),
        (lambda t: torch.nn.Parameter(t), r"image\.detach\(\)"),
        (lambda t: t.to_sparse(), r"^denoise_tv: image is a tensor of layout torch\.sparse_coo: pass image\.to_dense"),
        (lambda t: t.to("meta"), r"'meta', which has no values"),
        (lambda t: torch.complex(t, t), r"got complex128"),
        (lambda t: t > 100, r"got bool: give image\.astype"),
    ],
)
def test_what_is_refused(make, said):
    with pytest.raises(TypeError, match=said):
        gr.denoise_tv(make(torch.from_numpy(IMAGE)), lam=0.3, **ON)


def test_types_of_torch_name_types_of_numpy():
    tensor = torch.from_numpy(IMAGE).float()
    grid = gr.GridGraph(tuple(tensor.shape))
    assert gr.regularize(tensor, grid, dtype=torch.float64, max_iter=1, **ON).value.dtype == torch.float64
    with pytest.raises(ValueError, match=r"dtype must be float32 or float64, got torch\.bfloat16"):
        gr.regularize(tensor, grid, dtype=torch.bfloat16, **ON)


def test_zero_dimensional_tensors_are_numbers():
    found = gr.denoise_tv(torch.from_numpy(IMAGE), lam=torch.tensor(0.25), max_iter=torch.tensor(2), **ON)
    np.testing.assert_array_equal(found.numpy(), gr.denoise_tv(IMAGE, lam=0.25, max_iter=2, **ON))


def test_memory_of_warp_becomes_a_tensor_without_a_copy():
    """As a result on a CUDA device does; here on the CPU, where no argument is lent."""
    wp = pytest.importorskip("warp")
    from gpureg.exchange import torch as library

    numbers = wp.array(np.arange(12, dtype=np.float32), device="cpu")
    tensor = library.from_warp(numbers, (3, 4), torch.zeros(3, 4))
    assert tensor.shape == (3, 4) and tensor.data_ptr() == numbers.ptr
    assert library.to_warp(tensor, "x") is None and library.place(tensor) is None
