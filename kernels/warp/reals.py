"""Number types, and the arithmetic of functions of several channels.

`real` is wp.float32 or wp.float64. A function of M channels is an array of vectors of M reals, so that a kernel treats
all channels of a vertex at once; a gradient norm or a conductance is a vector of G reals, one for all channels (G = 1)
or one each (G = M).

A factory of this folder is called once per combination of what is compiled in, and keeps what it made: kernels and
functions close over the types they are for.
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
    scaled(a, d)     the function d, each channel times its conductance in the norm a
    raised(x, shift, power)   (x + shift)^power, of each number of a norm
    """

    function: Any
    norm: Any
    squared: Any
    scaled: Any
    raised: Any


@functools.cache
def vector(real, length):
    """A vector type."""
    return wp.types.vector(length=length, dtype=real)


@functools.cache
def reading(dtype, ndim=2):
    """A function that reads an array of so many axes, which is contiguous, as all arrays of this project are.

    Warp's own indexing multiplies by strides that it loads each time: a neighbour loop spends a third of its time so,
    and another third where it is a loop over a range, whose step may have either sign: hence the `while` loops here.
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
    """A function that writes a number of such an array."""
    if ndim == 2:

        @wp.func_native("a.data[(size_t)i * a.shape[1] + j] = x;")
        def put(a: wp.array2d(dtype=dtype), i: int, j: int, x: dtype): ...

    else:

        @wp.func_native("a.data[((size_t)i * a.shape[1] + j) * a.shape[2] + k] = x;")
        def put(a: wp.array3d(dtype=dtype), i: int, j: int, k: int, x: dtype): ...

    return put


def smallest(real):
    """A sum of weights below this is taken for 0: of numbers so small a quotient has few digits left, or none."""
    return wp.constant(real(1e-290 if real == wp.float64 else 1e-30))


@functools.cache
def raising(real):
    """x^power for x >= 0. The exponents of p = 1 and p = 2 avoid pow; the branch is the same for all work items."""

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
    """The types and functions for M channels with G gradient norms, G = 1 or M."""
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
    """The type of an argument that is a number or one value per vertex, and a function that gives its value at one."""
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
    """The type of an argument to divide by, of 1 channel or M, or a number (0), and a function that divides by it.

    What is divided by infinity is 0.
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
