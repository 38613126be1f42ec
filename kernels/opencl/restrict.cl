/* restrict(a) = sum of x(u) - y(u) over the vertices u of the aggregate a
 *
 * From the functions x, y of a level of multigrid to one of the next level, a stored graph. The vertices are given by
 * their places in a function: channel c of a vertex is at place unit + c stride.
 *
 * One work item: one aggregate. The sum has a fixed order, that of the list.
 * Traffic per vertex of the finer level: reads its place and 2 M values; per aggregate: reads a start, writes M values.
 */
#include "reals.cl"

#ifndef M
#define M 1
#endif
#ifndef INDEX
#define INDEX int
#endif

/* "restrict" itself is a word of the language */
__kernel void restricted(
    const long n,                 /* aggregates */
    __global const INDEX *starts, /* (n + 1,): where the list of each aggregate begins */
    __global const INDEX *places, /* (members,) */
    const long unit,
    const long stride,
    __global const real *x, /* M channels */
    __global const real *y, /* M channels */
    /* output */
    __global real *out) /* (n, M) */
{
    const long a = get_global_id(0);
    if (a >= n) return;
    real sum[M];
    for (int c = 0; c < M; ++c) sum[c] = 0;
    for (long i = starts[a]; i < starts[a + 1]; ++i) {
        const long at = (long)places[i] * unit;
        for (int c = 0; c < M; ++c) sum[c] += x[at + c * stride] - y[at + c * stride];
    }
    for (int c = 0; c < M; ++c) out[a * M + c] = sum[c];
}
