/* x(u) += e(a) for all vertices u of the aggregate a
 *
 * From a function e of a level of multigrid, a stored graph, to one of the level before it. The vertices are given by
 * their places as in restrict.cl; x of a vertex in no list does not change.
 *
 * One work item: one aggregate.
 * Traffic per vertex of the finer level: reads its place and M values, writes M; per aggregate: reads a start and M
 * values.
 */
#include "reals.cl"

#ifndef M
#define M 1
#endif
#ifndef INDEX
#define INDEX int
#endif

__kernel void prolong(
    const long n,                 /* aggregates */
    __global const INDEX *starts, /* (n + 1,): where the list of each aggregate begins */
    __global const INDEX *places, /* (members,) */
    const long unit,
    const long stride,
    __global const real *e, /* (n, M) */
    /* input and output */
    __global real *x) /* M channels */
{
    const long a = get_global_id(0);
    if (a >= n) return;
    real add[M];
    for (int c = 0; c < M; ++c) add[c] = e[a * M + c];
    for (long i = starts[a]; i < starts[a + 1]; ++i) {
        const long at = (long)places[i] * unit;
        for (int c = 0; c < M; ++c) x[at + c * stride] += add[c];
    }
}
