"""Number types, and the arithmetic of functions of several channels.

`real` is wp.float32 or wp.float64. A function of M channels is an array of vectors of M reals. A gradient norm or a
conductance is a vector of G reals: one for all channels (G = 1) or one per channel (G = M).

The `make` functions of this folder are cached: each runs once per combination of options and types.
"""

import functools
from dataclasses import dataclass
from typing import Any

import warp as wp


@dataclass(frozen=True, eq=False)
class Channels:
    """Types and functions for M channels with G gradient norms.

    function, norm   vectors of M and of G reals
    squared(d)       |d|^2 as a norm: summed over the channels if G = 1
    scaled(a, d)     the function d, each channel multiplied by its conductance a
    raised(x, shift, power)   (x + shift)^power, for each number of a norm
    """

    function: Any
    norm: Any
    squared: Any
    scaled: Any
    raised: Any


@functools.cache
def vector(real, length):
    """Return a vector type."""
    return wp.types.vector(length=length, dtype=real)


@functools.cache
def reading(dtype, ndim=2):
    """Make a function that reads a contiguous array of `ndim` axes; all arrays of this project are contiguous.

    Warp's own indexing loads and multiplies strides, a third of the time of a loop over neighbours. A loop over a range
    takes another third, as its step may have either sign: the kernels use `while` instead.
    """
    if ndim == 1:

        @wp.func_native("return a.data[i];")
        def at(a: wp.array(dtype=dtype), i: int) -> dtype: ...

    elif ndim == 2:

        @wp.func_native("return a.data[(size_t)i * a.shape[1] + j];")
        def at(a: wp.array2d(dtype=dtype), i: int, j: int) -> dtype: ...

    else:

        @wp.func_native("return a.data[((size_t)i * a.shape[1] + j) * a.shape[2] + k];")
        def at(a: wp.array3d(dtype=dtype), i: int, j: int, k: int) -> dtype: ...

    return at


@functools.cache
def writing(dtype, ndim=2):
    """Make a function that writes to a contiguous array of `ndim` axes."""
    if ndim == 2:

        @wp.func_native("a.data[(size_t)i * a.shape[1] + j] = x;")
        def put(a: wp.array2d(dtype=dtype), i: int, j: int, x: dtype): ...

    else:

        @wp.func_native("a.data[((size_t)i * a.shape[1] + j) * a.shape[2] + k] = x;")
        def put(a: wp.array3d(dtype=dtype), i: int, j: int, k: int, x: dtype): ...

    return put


def smallest(real):
    """Return the sum of weights that counts as 0, because quotients of smaller numbers lose their digits."""
    return wp.constant(real(1e-290 if real == wp.float64 else 1e-30))


@functools.cache
def raising(real):
    """Make x^power for x >= 0, without pow for the exponents of p = 1 and p = 2."""

    @wp.func
    def raise_(x: real, power: real) -> real:
        if power == real(1.0):
            return x
        if power == real(0.0):
            return real(1.0)
        if power == real(0.5):
            return wp.sqrt(x)
        if power == real(-0.5):
            return real(1.0) / wp.sqrt(x)
        return wp.pow(x, power)

    return raise_


@functools.cache
def make(real, M, G):
    """Make the types and functions for M channels with G gradient norms, G = 1 or M."""
    function, norm = vector(real, M), vector(real, G)
    raise_ = raising(real)

    if G == 1:

        @wp.func
        def squared(d: function) -> norm:
            return norm(wp.dot(d, d))

        @wp.func
        def scaled(a: norm, d: function) -> function:
            return a[0] * d

    else:

        @wp.func
        def squared(d: function) -> norm:
            return wp.cw_mul(d, d)

        @wp.func
        def scaled(a: norm, d: function) -> function:
            return wp.cw_mul(a, d)

    @wp.func
    def raised(x: norm, shift: real, power: real) -> norm:
        result = norm()
        for c in range(G):
            result[c] = raise_(x[c] + shift, power)
        return result

    return Channels(function, norm, squared, scaled, raised)


@functools.cache
def per_vertex(real, Place, is_array):
    """Return the type of an argument, a number or one value per vertex, and a function for its value at a vertex."""
    if is_array:
        argument, at = wp.array2d(dtype=vector(real, 1)), reading(vector(real, 1))

        @wp.func
        def value_at(x: argument, u: Place) -> real:
            return at(x, u[0], u[1])[0]

    else:
        argument = real

        @wp.func
        def value_at(x: real, u: Place) -> real:
            return x

    return argument, value_at


@functools.cache
def divided(real, M, over):
    """Return the type of a divisor, of 1 or M channels or a number (`over` = 0), and a function that divides by it.

    A quotient by infinity is 0.
    """
    function = vector(real, M)
    argument = wp.array2d(dtype=vector(real, over)) if over else real
    at = reading(vector(real, over)) if over else None

    if over == 0:

        @wp.func
        def quotient(x: function, by: real, row: int, k: int) -> function:
            return x / by

    elif over == 1:

        @wp.func
        def quotient(x: function, by: argument, row: int, k: int) -> function:
            return x / at(by, row, k)[0]

    else:

        @wp.func
        def quotient(x: function, by: argument, row: int, k: int) -> function:
            return wp.cw_div(x, at(by, row, k))

    return argument, quotient
