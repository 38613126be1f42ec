"""A few numbers on the device, computed from one another, so that the host need not read them

Task 0: forget all differences and the largest quotient.
Task 1, of sweeps that must not raise the energy: worst = max(worst, e(first) / e(second)); infinity for a NaN.
Task 2, of Anderson acceleration: add the difference at the place `first`, and compute the c that minimise
|r - dR c|, from G = dR' dR and b = dR' r by Cholesky's method, with columns of length 1:
    (S G S + ridge count I) x = S b,   c = S x,   S = diag(1 / |column|), 0 for a column of zeros
for the newest `count` of `memory` differences; the others get 0.
Task 3: accept the mix if its energy is at most that before; otherwise drop the older half of the differences.

One work item does all. The places of the numbers are in gpureg/backends/scalars.py.
Traffic: (memory + 1)^2 numbers at most.
"""

import functools

import warp as wp

ONE, TAKEN, LEFT, COUNT, ACCEPTED, REJECTED, MIXED, BEFORE, WORST = range(9)
PRODUCT, ROW = 11, 12


@functools.cache
def make(task, memory):
    """Make the kernel of a task, for this many differences."""
    places = memory + 1
    PRODUCTS, COEFFICIENTS, GRAM = ROW + places, ROW + 2 * places, ROW + 3 * places
    numbers_type = wp.array(dtype=wp.float64)

    @wp.func
    def place(newest: int, i: int) -> int:
        """Return the place of the i-th newest difference."""
        return (newest + wp.static(places) - i) % wp.static(places)

    @wp.func
    def begin(numbers: numbers_type, first: int, second: int, ridge: wp.float64, scratch: numbers_type):
        numbers[wp.static(ONE)] = wp.float64(1)
        numbers[wp.static(COUNT)] = wp.float64(0)
        numbers[wp.static(WORST)] = wp.float64(0)

    @wp.func
    def watch(numbers: numbers_type, first: int, second: int, ridge: wp.float64, scratch: numbers_type):
        new = numbers[first]
        old = numbers[second]
        if not (new <= old):
            quotient = wp.float64(wp.inf)
            if old > wp.float64(0) and not wp.isnan(new):
                quotient = new / old
            if quotient > numbers[wp.static(WORST)]:
                numbers[wp.static(WORST)] = quotient

    @wp.func
    def solve(numbers: numbers_type, first: int, second: int, ridge: wp.float64, scratch: numbers_type):
        count = wp.min(int(numbers[wp.static(COUNT)]) + 1, wp.static(memory))
        numbers[wp.static(COUNT)] = wp.float64(count)
        # the new residual is the last one plus the new difference
        for k in range(wp.static(places)):
            product = numbers[wp.static(ROW) + k]
            numbers[wp.static(GRAM) + first * wp.static(places) + k] = product
            numbers[wp.static(GRAM) + k * wp.static(places) + first] = product
            numbers[wp.static(PRODUCTS) + k] = numbers[wp.static(PRODUCTS) + k] + product
            numbers[wp.static(COEFFICIENTS) + k] = wp.float64(0)
        numbers[wp.static(PRODUCTS) + first] = numbers[wp.static(PRODUCT)]
        # scratch: the triangle row by row, then x, then the scales
        x = wp.static(memory * memory)
        scale = wp.static(memory * memory + memory)
        for i in range(count):
            square = numbers[wp.static(GRAM) + place(first, i) * wp.static(places) + place(first, i)]
            scratch[scale + i] = wp.float64(0)
            if square > wp.float64(0):
                scratch[scale + i] = wp.float64(1) / wp.sqrt(square)
        for i in range(count):
            for j in range(i + 1):
                rest = numbers[wp.static(GRAM) + place(first, i) * wp.static(places) + place(first, j)]
                rest = rest * scratch[scale + i] * scratch[scale + j]
                if i == j:
                    rest += ridge * wp.float64(count)
                for k in range(j):
                    rest -= scratch[i * wp.static(memory) + k] * scratch[j * wp.static(memory) + k]
                if i == j:
                    # rounding can make a dependent column's rest negative: its ridge remains
                    rest = wp.sqrt(wp.max(rest, ridge))
                else:
                    rest = rest / scratch[j * wp.static(memory) + j]
                scratch[i * wp.static(memory) + j] = rest
            value = numbers[wp.static(PRODUCTS) + place(first, i)] * scratch[scale + i]
            for k in range(i):
                value -= scratch[i * wp.static(memory) + k] * scratch[x + k]
            scratch[x + i] = value / scratch[i * wp.static(memory) + i]
        for r in range(count):
            i = count - 1 - r
            value = scratch[x + i]
            for k in range(i + 1, count):
                value -= scratch[k * wp.static(memory) + i] * scratch[x + k]
            value = value / scratch[i * wp.static(memory) + i]
            scratch[x + i] = value
            numbers[wp.static(COEFFICIENTS) + place(first, i)] = value * scratch[scale + i]

    @wp.func
    def judge(numbers: numbers_type, first: int, second: int, ridge: wp.float64, scratch: numbers_type):
        one = wp.float64(1)
        count = int(numbers[wp.static(COUNT)])
        if numbers[wp.static(MIXED)] <= numbers[wp.static(BEFORE)]:
            numbers[wp.static(TAKEN)] = one
            numbers[wp.static(LEFT)] = wp.float64(0)
            numbers[wp.static(ACCEPTED)] = numbers[wp.static(ACCEPTED)] + one
        else:
            numbers[wp.static(TAKEN)] = wp.float64(0)
            numbers[wp.static(LEFT)] = one
            numbers[wp.static(REJECTED)] = numbers[wp.static(REJECTED)] + one
            numbers[wp.static(COUNT)] = wp.float64(count - count // 2)

    step = (begin, watch, solve, judge)[task]

    @wp.kernel(module="unique", enable_backward=False)
    def scalars(
        first_place: int,
        second_place: int,
        ridge: wp.float64,
        scratch: numbers_type,  # (memory^2 + 2 memory,), of task 2
        first: wp.vec2i,  # the launch's first work item, 0
        # output
        numbers: numbers_type,
    ):
        step(numbers, first_place, second_place, ridge, scratch)

    return scalars
