"""out = T^-1 (T r / eigenvalues),  T the cosine transform (DCT-II) along each axis of a grid

    (T r)(k) = 2 sum_i r(i) cos(pi k (2 i + 1) / (2 n))

One launch is a step of one axis with n cells (Makhoul 1980), in a work space of complex numbers. Each has
cells of two lines as its real and imaginary part.
  step 0: from the function, sorted: v(i) = r(2 i), v(n - 1 - i) = r(2 i + 1)
  step 1: a step of the Fourier transform V of v, of radix R (Stockham): sums of R numbers, R any factor of n
  step 2: to the function: (T r)(k) = w V(k) + conj(w) V(n - k), w = exp(-i pi k / (2 n)), divided by eigenvalues
and backward: V(k) = conj(w) (t(k) - i t(n - k)) / 2 from the function, the same Fourier transform, and
v(i) = V(-i) / n.

One work item: a number of the work space.
Traffic per cell and axis: steps 0 and 2 read 1 number (step 2 and eigenvalues) and write 1, step 1 likewise; the R
reads of step 1 are shared with R - 1 neighbours.
"""

import functools

import warp as wp


@functools.cache
def struct(real):
    """Make the struct with the lines, the step and the arrays."""
    complex_t = wp.types.vector(2, real)

    @wp.struct
    class Lines:
        n: wp.int64  # cells of a line
        lines: wp.int64  # of all channels
        backward: wp.int32  # the inverse transform
        by_line: wp.int32  # the next number of the work space is of the next pair of lines, not of the next cell
        columns: wp.int64  # lines side by side in a row
        inner: wp.int64  # rows side by side in a slice
        outer: wp.int64  # slices
        block: wp.int64  # rows of a slice
        width: wp.int64  # cells of a row of the grid
        channels: wp.int64  # of the function
        along: wp.int64  # cells of the function from a cell of a line to the next one
        radix: wp.int64  # R of step 1
        done: wp.int64  # product of the radices before
        divided: wp.int32  # whether step 2 divides
        roots: wp.array(dtype=complex_t)  # (n,): exp(-2 pi i k / n)
        quarter: wp.array(dtype=complex_t)  # (n,): exp(-pi i k / (2 n))
        over: wp.array(dtype=real)  # eigenvalues, row by row; read if `divided`
        f: wp.array(dtype=real)  # the function that step 0 reads
        source: wp.array(dtype=complex_t)  # the work space that steps 1 and 2 read
        to: wp.array(dtype=complex_t)  # the work space that steps 0 and 1 write

    return Lines


@functools.cache
def make(real, step):
    """Make the kernel of a step: 0, 1 or 2."""
    complex_t, Lines = wp.types.vector(2, real), struct(real)

    @wp.func
    def start(at: Lines, line: wp.int64):
        """Return the first cell of a line: lines follow the columns, then rows, then channels."""
        row = line // at.columns
        piece = row // at.inner
        return ((piece % at.outer) * at.block + row % at.inner) * at.width + line % at.columns

    @wp.func
    def place(at: Lines, line: wp.int64, i: wp.int64):
        """Return the place of cell i of a line in the function."""
        channel = line // at.columns // at.inner // at.outer
        return (start(at, line) + i * at.along) * at.channels + channel

    @wp.func
    def times(a: complex_t, b: complex_t):
        return complex_t(a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0])

    @wp.func
    def conjugate(a: complex_t):
        return complex_t(a[0], -a[1])

    @wp.func
    def number(at: Lines, line: wp.int64, i: wp.int64):
        """Return cell i of a line and of the next one; 0 if there is no next one."""
        second = real(0)
        if line + wp.int64(1) < at.lines:
            second = at.f[place(at, line + wp.int64(1), i)]
        return complex_t(at.f[place(at, line, i)], second)

    @wp.func
    def sorted_cell(at: Lines, line: wp.int64, i: wp.int64):
        two = wp.int64(2)
        if at.backward != 0:
            t = number(at, line, i)
            if i > wp.int64(0):
                other = number(at, line, at.n - i)
                t += complex_t(other[1], -other[0])
            return times(t, conjugate(at.quarter[i])) / real(2)
        if two * i < at.n:
            return number(at, line, two * i)
        return number(at, line, two * (at.n - i) - wp.int64(1))

    @wp.func
    def summed(at: Lines, origin: wp.int64, cell_step: wp.int64, i: wp.int64):
        left = at.n // (at.radix * at.done)
        q = i % at.done
        k = i // at.done % at.radix
        p = i // at.done // at.radix
        turn = k * (at.n // at.radix) % at.n
        angle = p * k * at.done % at.n
        total = complex_t()
        for j in range(int(at.radix)):
            total += times(at.source[origin + (q + at.done * (p + left * wp.int64(j))) * cell_step], at.roots[angle])
            angle += turn
            if angle >= at.n:
                angle -= at.n
        return total

    @wp.func
    def result(at: Lines, origin: wp.int64, cell_step: wp.int64, i: wp.int64):
        two = wp.int64(2)
        if at.backward != 0:
            v = i // two
            if i % two == wp.int64(1):
                v = at.n - wp.int64(1) - i // two
            return at.source[origin + (at.n - v) % at.n * cell_step] / real(at.n)
        w = at.quarter[i]
        t = times(w, at.source[origin + i * cell_step])
        return t + times(conjugate(w), at.source[origin + (at.n - i) % at.n * cell_step])

    @wp.kernel(module="unique", enable_backward=False)
    def cosine_solve(
        at: Lines,
        first: wp.vec2i,  # the launch's first work item, 0
        # output
        out: wp.array(dtype=real),  # the function that step 2 writes; it may be f
    ):
        here = wp.int64(first[0]) + wp.int64(wp.tid())
        pairs = (at.lines + wp.int64(1)) // wp.int64(2)
        pair = here // at.n
        i = here % at.n
        origin = pair * at.n
        cell_step = wp.int64(1)
        if at.by_line != 0:
            pair = here % pairs
            i = here // pairs
            origin = pair
            cell_step = pairs
        line = wp.int64(2) * pair
        if wp.static(step == 0):
            at.to[here] = sorted_cell(at, line, i)
        if wp.static(step == 1):
            at.to[here] = summed(at, origin, cell_step, i)
        if wp.static(step == 2):
            t = result(at, origin, cell_step, i)
            both = line + wp.int64(1) < at.lines
            if at.divided != 0:
                t[0] = t[0] / at.over[start(at, line) + i * at.along]
                if both:
                    t[1] = t[1] / at.over[start(at, line + wp.int64(1)) + i * at.along]
            out[place(at, line, i)] = t[0]
            if both:
                out[place(at, line + wp.int64(1), i)] = t[1]

    return cosine_solve
