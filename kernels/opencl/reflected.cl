/* The place of a cell beyond an axis of this size, reflected without repeating the edge cell, as often as needed. */
#ifndef REFLECTED_CL
#define REFLECTED_CL
static inline int reflected(const int place, const int size)
{
    const int period = 2 * (size - 1);
    int at = abs(place);
    if (at > period) at = period > 0 ? at % period : 0; /* far beyond the axis: rarely a division */
    return min(at, period - at);
}
#endif
