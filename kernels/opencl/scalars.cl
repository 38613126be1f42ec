/* A few numbers on the device, computed from one another, so that the host need not read them
 *
 * TASK 0: forget all differences and the largest quotient.
 * TASK 1, of sweeps that must not raise the energy: worst = max(worst, e(first) / e(second)); infinity for a NaN.
 * TASK 2, of Anderson acceleration: add the difference at the place `first`, and compute the c that minimise
 * |r - dR c|, from G = dR' dR and b = dR' r by Cholesky's method, with columns of length 1:
 *     (S G S + ridge count I) x = S b,   c = S x,   S = diag(1 / |column|), 0 for a column of zeros
 * for the newest `count` of MEMORY differences; the others get 0.
 * TASK 3: accept the mix if its energy is at most that before; otherwise drop the older half of the differences.
 *
 * One work item does all. The places of the numbers are in gpureg/backends/scalars.py.
 * Traffic: (MEMORY + 1)^2 numbers at most.
 *   -DTASK=2   -DMEMORY=10
 */
#include "sums.cl"

#ifndef TASK
#define TASK 2
#endif
#ifndef MEMORY
#define MEMORY 10
#endif

#define PLACES (MEMORY + 1)
enum { ONE, TAKEN, LEFT, COUNT, ACCEPTED, REJECTED, MIXED, BEFORE, WORST, ENERGIES, PRODUCT = 11, ROW };
enum { PRODUCTS = ROW + PLACES, COEFFICIENTS = PRODUCTS + PLACES, GRAM = COEFFICIENTS + PLACES };

static inline sum_t get(__global const long_sum *numbers, const int at) { return sum_value(numbers[at]); }

static inline void put(__global long_sum *numbers, const int at, const sum_t x)
{
    long_sum s = sum_start();
    s.sum = x;
    numbers[at] = s;
}

__kernel void scalars(
    const int first,
    const int second,
    const real ridge,
    /* output */
    __global long_sum *numbers)
{
    if (get_global_id(0) > 0) return;
#if TASK == 0
    put(numbers, ONE, 1);
    put(numbers, COUNT, 0);
    put(numbers, WORST, 0);
#elif TASK == 1
    const sum_t new = get(numbers, first), old = get(numbers, second);
    sum_t quotient = new <= old ? 0 : old > 0 ? new / old : INFINITY;
    if (isnan(quotient)) quotient = INFINITY;
    if (quotient > get(numbers, WORST)) put(numbers, WORST, quotient);
#elif TASK == 2
    __local sum_t matrix[MEMORY * MEMORY], x[MEMORY], scale[MEMORY];
    const int before = (int)get(numbers, COUNT), count = min(before + 1, MEMORY);
    put(numbers, COUNT, count);
    /* the new residual is the last one plus the new difference */
    for (int k = 0; k < PLACES; ++k) {
        put(numbers, GRAM + first * PLACES + k, get(numbers, ROW + k));
        put(numbers, GRAM + k * PLACES + first, get(numbers, ROW + k));
        put(numbers, PRODUCTS + k, get(numbers, PRODUCTS + k) + get(numbers, ROW + k));
        put(numbers, COEFFICIENTS + k, 0);
    }
    put(numbers, PRODUCTS + first, get(numbers, PRODUCT));
#define PLACE(i) ((first + PLACES - (i)) % PLACES) /* of the i-th newest difference */
    for (int i = 0; i < count; ++i) {
        const sum_t square = get(numbers, GRAM + PLACE(i) * PLACES + PLACE(i));
        scale[i] = square > 0 ? 1 / sqrt(square) : 0;
    }
    for (int i = 0; i < count; ++i) {
        for (int j = 0; j <= i; ++j) {
            sum_t rest = get(numbers, GRAM + PLACE(i) * PLACES + PLACE(j)) * scale[i] * scale[j];
            if (i == j) rest += (sum_t)ridge * count;
            for (int k = 0; k < j; ++k) rest -= matrix[i * MEMORY + k] * matrix[j * MEMORY + k];
            /* rounding can make a dependent column's rest negative: its ridge remains */
            if (i == j)
                rest = sqrt(rest > (sum_t)ridge ? rest : (sum_t)ridge);
            else
                rest /= matrix[j * MEMORY + j];
            matrix[i * MEMORY + j] = rest;
        }
        x[i] = get(numbers, PRODUCTS + PLACE(i)) * scale[i];
        for (int k = 0; k < i; ++k) x[i] -= matrix[i * MEMORY + k] * x[k];
        x[i] /= matrix[i * MEMORY + i];
    }
    for (int i = count - 1; i >= 0; --i) {
        for (int k = i + 1; k < count; ++k) x[i] -= matrix[k * MEMORY + i] * x[k];
        x[i] /= matrix[i * MEMORY + i];
        put(numbers, COEFFICIENTS + PLACE(i), x[i] * scale[i]);
    }
#else
    const int accepted = get(numbers, MIXED) <= get(numbers, BEFORE), count = (int)get(numbers, COUNT);
    put(numbers, TAKEN, accepted);
    put(numbers, LEFT, !accepted);
    put(numbers, accepted ? ACCEPTED : REJECTED, get(numbers, accepted ? ACCEPTED : REJECTED) + 1);
    if (!accepted) put(numbers, COUNT, count - count / 2);
#endif
}
