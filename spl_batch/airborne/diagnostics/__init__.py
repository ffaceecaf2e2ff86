"""Diagnostics of a result: five general measures that warn where a rule for each cause is unknown.

1. Noise that is observed over what is expected, by layer of height and cell (``noise_layers``,
   ``noise_fit``).
2. Returns that fill the air above ground, or float with nothing below them (``air_fill``).
3. Followers of hard surfaces by lag, against the law of afterpulses
   (:mod:`spl_batch.airborne.afterpulse.law_warnings`).
4. P-values of noise that lies alone, which are uniform where its model holds (``noise_fit``).
5. Terrain whose standard deviation is large: its share and its largest place (``terrain_sigma``).

Nothing is changed by any of them. No source has them.
"""
