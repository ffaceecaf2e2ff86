"""Which share of the beamlets returned in published set-ups.

Run ``python -m benchmarks.airborne.beams.light``.

Returns per m2 and flightline over beamlets fired per m2: the beamlets of a second over the area of
a second. [W18] 2.1 gives no speed; those of survey aircraft are taken. [W17] Table 2-2 gives area.
"""

import math

KNOT_M_S = 1852.0 / 3600.0

SPEEDS_KNOTS = (150.0, 200.0)
"""Slow and fast for the aircraft that carry such sensors."""

CONES = {
    "Easton [W18]": (18.0, 3500.0, 9.0, 60e3 * 100),
    "Lufkin [W18]": (20.0, 2000.0, 15.0, 50e3 * 100),
}
"""Returns per m2 and line, height [m], half-angle of the cone [deg], beamlets per second."""

AREAS = {"HRQLS [W17 Table 2-2]": (12.0, (400.0, 640.0), 25e3 * 100)}
"""Returns per m2 and line, area per hour [km2], beamlets per second."""


def returned(per_m2: float, beamlets_hz: float, area_m2_s: float) -> float:
    """Share of the beamlets that returned [%].

    Parameters
    ----------
    per_m2 : float
        Returns of a flightline [1/m2].
    beamlets_hz : float
        Beamlets fired [1/s].
    area_m2_s : float
        Area that they fall on [m2/s].
    """
    return 100.0 * per_m2 * area_m2_s / beamlets_hz


def main() -> None:
    """Print the shares."""
    for name, (per_m2, height_m, cone_deg, beamlets_hz) in CONES.items():
        swath_m = 2.0 * height_m * math.tan(math.radians(cone_deg))
        for knots in SPEEDS_KNOTS:
            share = returned(per_m2, beamlets_hz, swath_m * knots * KNOT_M_S)
            print(f"{name}, {knots:g} knots: {share:.0f} % of the beamlets returned")
    for name, (per_m2, areas_km2_h, beamlets_hz) in AREAS.items():
        for area in areas_km2_h:
            share = returned(per_m2, beamlets_hz, area * 1e6 / 3600.0)
            print(f"{name}, {area:g} km2/h: {share:.0f} % of the beamlets returned")


if __name__ == "__main__":
    main()
