/* The place of a cell beyond an axis of this size, reflected without repeating the edge cell, as often as needed. */
#ifndef REFLECTED_CL
#define REFLECTED_CL
static inline int reflected(const int place, const int size)
{
    if (size == 1) return 0;
    const int period = 2 * (size - 1), rest = ((place % period) + period) % period;
    return min(rest, period - rest);
}
#endif
