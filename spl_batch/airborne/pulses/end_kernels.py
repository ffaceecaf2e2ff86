"""Kernel of :mod:`~spl_batch.airborne.pulses.pulse_returns`: the ends of each pulse."""

from spl_batch.numerics.compiled import njit


@njit()
def mark_ends(order, start, count, z, x, y, number, first, last):  # type: ignore[no-untyped-def]
    """Mark the highest return of each pulse as its first, the lowest as its last.

    Of returns as high the easting decides, then the northing, then the return number, then the row.

    Parameters
    ----------
    order : (n,) int64
        Rows, those of a pulse together and rising.
    start, count : (p,) int64
        Where each pulse begins in ``order``, and its returns.
    z, x, y, number : (n,) integer
        Of each row.
    first, last : (n,) bool
        Set at the rows that are.
    """
    for k in range(len(start)):
        low = high = order[start[k]]
        for at in range(start[k] + 1, start[k] + count[k]):
            row = order[at]
            own = z[row], x[row], y[row], number[row]
            if own < (z[low], x[low], y[low], number[low]):
                low = row
            if own >= (z[high], x[high], y[high], number[high]):
                high = row
        first[high], last[low] = True, True
