"""The relations of the metamorphic tests: what a change of the input must do to the result.

A relation is a function of a subject, a backend and a draw of numbers, named in ``RELATIONS`` by the sort of input.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from subjects import RING, Array, Subject, on_graph, picture

import gpureg as gr

# Doors compute in float32, in units in which the spread of the data is 1 to 2. Measured over all rows and two inputs:
# two orders of summation differ by at most 20 roundings of 2^-24; twice as many are allowed.
ROUNDINGS = 40 * 2.0**-24


@dataclass(frozen=True)
class Draw:
    """The numbers that hypothesis chooses.

    Attributes
    ----------
    seed : int
        Of the input.
    power : int
        The exponent k of a factor 2^k.
    shift : float
        A constant to add.
    far : float
        The new value of a sample, in the spread of the data.
    """

    seed: int = 1
    power: int = 70
    shift: float = 1e8
    far: float = 1e6


def close(found: Array, expected: Array, within: float) -> None:
    """Assert that two results differ by at most `within`."""
    assert found.shape == expected.shape
    assert float(np.abs(found - expected).max(initial=0)) <= within


def values_of(subject: Subject, seed: int) -> Array:
    """Return the input of a subject; its spread is about 1."""
    if subject.sort == "graph":
        return picture(seed, (5, 8)).ravel()
    return picture(seed, (24, 26, 3) if subject.sort == "colours" else (24, 26))


def scaled(subject: Subject, backend: str, draw: Draw) -> None:
    """Times 2^k: the same bits times 2^k, or the same numbers for powers that are not exact."""
    values, unit = values_of(subject, draw.seed), 2.0**draw.power
    found = subject.call(values * unit, unit, backend).astype(np.float64) / unit
    expected = subject.call(values, 1.0, backend).astype(np.float64)
    close(found, expected, 0.0 if subject.exact else ROUNDINGS)


def shifted(subject: Subject, backend: str, draw: Draw) -> None:
    """Plus a constant: the result plus it, up to the rounding of the sums."""
    values = values_of(subject, draw.seed)
    found = subject.call(values + draw.shift, 1.0, backend) - draw.shift
    # the data themselves are rounded to float64 by the addition, and the result once more; an offset below 8 spreads
    # stays in the data, and float32 rounds what is larger by more
    rounding = 4 * np.spacing(abs(draw.shift) + 2)
    near = 1 + min(abs(draw.shift), 8.0)
    close(found, subject.call(values, 1.0, backend), near * ROUNDINGS + 40 * rounding)


def flipped(subject: Subject, backend: str, draw: Draw) -> None:
    """An axis reversed: the result reversed."""
    values = values_of(subject, draw.seed)[:23, :23]
    found = np.flip(subject.call(np.flip(values, 0), 1.0, backend), 0)
    close(found, subject.call(values, 1.0, backend), ROUNDINGS)


def transposed(subject: Subject, backend: str, draw: Draw) -> None:
    """Two axes exchanged: the result with exchanged axes."""
    values = values_of(subject, draw.seed)
    found = np.swapaxes(subject.call(np.swapaxes(values, 0, 1), 1.0, backend), 0, 1)
    close(found, subject.call(values, 1.0, backend), ROUNDINGS)


def thickened(subject: Subject, backend: str, draw: Draw) -> None:
    """An axis of length 1 inserted: the same result with this axis."""
    values = values_of(subject, draw.seed)
    expected = subject.call(values, 1.0, backend)
    for axis in range(3):
        found = subject.call(np.expand_dims(values, axis), 1.0, backend)
        close(np.squeeze(found, axis), expected, ROUNDINGS)


def framed(subject: Subject, backend: str, draw: Draw) -> None:
    """A constant frame around: the same result beyond the reach of the frame."""
    assert subject.reach is not None
    values, width = values_of(subject, draw.seed), subject.reach
    around = np.pad(values, width, constant_values=values.mean())
    inner = (slice(2 * width, -2 * width),) * 2
    found = subject.call(around, 1.0, backend)[inner]
    close(found, subject.call(values, 1.0, backend)[(slice(width, -width),) * 2], ROUNDINGS)


def spoiled(subject: Subject, backend: str, draw: Draw) -> None:
    """One sample changed to anything finite: the same result beyond its reach."""
    assert subject.reach is not None
    values, at = values_of(subject, draw.seed), (3, 4)
    other = values.copy()
    other[at] = draw.far
    far = np.abs(np.indices(values.shape) - np.array(at)[:, None, None]).max(axis=0) > subject.reach
    found, expected = (subject.call(x, 1.0, backend)[far] for x in (other, values))
    close(found, expected, ROUNDINGS)


def permuted(subject: Subject, backend: str, draw: Draw) -> None:
    """Channels in another order: the result with its channels in this order, bit for bit."""
    values = values_of(subject, draw.seed)
    expected = subject.call(values, 1.0, backend)
    close(subject.call(values[..., [2, 0, 1]], 1.0, backend), expected[..., [2, 0, 1]], 0.0)


def alone(subject: Subject, backend: str, draw: Draw) -> None:
    """A separate channel, far stronger or weaker than the others: what it gives alone, bit for bit."""
    values = values_of(subject, draw.seed) * [1.0, 2.0**-10, 2.0**12]
    # lam in units of 1 over the data's units is the same for all channels, whatever their contrast
    found = subject.call(values, 1.0, backend)
    for c in range(3):
        close(found[..., c : c + 1], subject.call(values[..., c : c + 1], 1.0, backend), 0.0)


def renumbered(subject: Subject, backend: str, draw: Draw) -> None:
    """Vertices in another order, with their edges: the result in this order."""
    values = values_of(subject, draw.seed)
    order = np.random.default_rng(draw.seed).permutation(len(values))
    place = np.argsort(order)
    rows, columns = place[RING.edge_rows()], place[RING.indices]
    edges = np.stack([rows, columns], 1)[rows < columns]
    other = gr.Graph.from_edges(edges, n_vertices=len(values))
    found, expected = on_graph(values[order], other, 1.0, backend), on_graph(values, RING, 1.0, backend)
    close(found, expected[order], ROUNDINGS)


def beside(subject: Subject, backend: str, draw: Draw) -> None:
    """Two components: what each gives alone, with settings that do not follow the data."""
    values, other = (values_of(subject, seed) for seed in (draw.seed, draw.seed + 1))
    n, u, v = len(values), RING.edge_rows(), RING.indices
    once = np.stack([u, v], 1)[u < v]
    both = gr.Graph.from_edges(np.concatenate([once, once + n]), n_vertices=2 * n)
    found = on_graph(np.concatenate([values, other]), both, 1.0, backend, eps=1e-3)
    expected = [on_graph(part, RING, 1.0, backend, eps=1e-3) for part in (values, other)]
    close(found, np.concatenate(expected), ROUNDINGS)


RELATIONS: dict[str, dict[str, Callable[[Subject, str, Draw], None]]] = {
    "image": {
        "scaled": scaled,
        "shifted": shifted,
        "flipped": flipped,
        "transposed": transposed,
        "thickened": thickened,
        "framed": framed,
        "spoiled": spoiled,
    },
    "colours": {"scaled": scaled, "shifted": shifted, "flipped": flipped, "permuted": permuted, "alone": alone},
    "graph": {"scaled": scaled, "shifted": shifted, "renumbered": renumbered, "beside": beside},
}

# Relations that need a distance beyond which a sample has no effect.
LOCAL = {"framed", "spoiled"}
