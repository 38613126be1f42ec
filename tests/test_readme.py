"""The README's examples run as they stand."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from cases import irregular, rng

README = Path(__file__).parent.parent / "README.md"
pytestmark = pytest.mark.skipif(not README.exists(), reason="the README is not beside the tests")


def test_python_examples_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GPUREG_BACKEND", "numpy")
    graph = irregular(40, 150, isolated=7)
    W = graph.to_scipy().tocoo()
    once = W.coords[0] < W.coords[1]
    scene = {
        "np": np,
        "image": 0.5 + 0.1 * rng(3).standard_normal((24, 25, 3)),
        "edges": np.stack(W.coords, axis=1)[once],
        "weights": W.data[once],
        "n": 40,
        "measured": [1, 5, 30],
        "f0": rng(5).random(40),
    }
    blocks = re.findall(r"```python\n(.*?)```", README.read_text("utf-8"), re.S)
    assert len(blocks) == 3
    exec(blocks[0].replace("gr.denoise_image(image)  ", "gr.denoise_image(image[..., 0])  "), scene)
    assert scene["clean"].shape == (24, 25)
    assert scene["flat"].shape == (24, 25, 3)
    exec(blocks[1], scene)
    assert np.array_equal(scene["result"].value[[1, 5, 30]], scene["f0"][[1, 5, 30]].astype(np.float32))
    scene["image"] = scene["image"][..., 0]
    exec(blocks[2], scene)
    assert scene["result"].iterations == 4


def test_backend_table_names_every_backend() -> None:
    from gpureg import backends

    text = README.read_text("utf-8")
    for name in backends.names():
        assert f"| `{name}` |" in text
