/* total = the sum of the parts of a long sum, or with MAXIMUM the largest one
 *
 * The second stage of dot, energy, duality_gap and max_change (sums.cl). The result stays on the device: the next
 * kernel can read it, and the host only needs to at a check.
 *
 * One work group: each work item adds every GROUP-th part, then all of them by a tree in local memory.
 * Traffic per part: reads 1 number; writes 1 in total.
 */
#ifndef GROUP
#define GROUP 256
#endif
#include "sums.cl"

__kernel void total(
    const int count,
    __global const long_sum *parts_, /* (count,) */
    const int at,
    /* output */
    __global long_sum *out) /* the number `at` */
{
    __local long_sum parts[GROUP];
    long_sum own = sum_start();
    for (int i = get_local_id(0); i < count; i += GROUP) own = BOTH(own, parts_[i]);
    long_sum whole = over_group(own, parts);
#if !defined(DOUBLE) && !defined(SUM_DOUBLE)
    /* the sum as a float32, and what that lost; an infinite sum has lost nothing */
    const float rounded = isfinite(whole.sum) ? whole.sum + whole.lost : whole.sum;
    whole.lost = isfinite(rounded) ? (whole.sum - rounded) + whole.lost : 0;
    whole.sum = rounded;
#endif
    if (get_local_id(0) == 0) out[at] = whole;
}
