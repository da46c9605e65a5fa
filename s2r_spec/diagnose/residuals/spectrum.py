"""At which frequency a model fails: where the spectrum of what it leaves has most of its power.

Data: differences of the machine and the improved simulator over time, one series a test. Estimator: the largest value
of the mean of their periodograms, under Hann windows and without their means. A compliance shows at its resonance, a
friction at the frequency of the motion.

Units: s, Hz. Source: Welch, *IEEE Transactions on Audio and Electroacoustics* 15 (1967) 70.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from s2r_spec.base.arrays import FloatArray

FINEST = 16
"""Budget: fewest samples of a series whose spectrum counts."""


def peak_frequency(series: Sequence[FloatArray], period: float) -> float | None:
    """Return the frequency [Hz] with most of the power of series, ``period`` [s] apart each; None without any."""
    known = [one - one.mean() for one in series if one.size >= FINEST and np.isfinite(one).all()]
    if not known:
        return None
    size = 4 * max(one.size for one in known)
    spectra = [np.abs(np.fft.rfft(one * np.hanning(one.size), size)) ** 2 / one.size for one in known]
    power = np.mean(spectra, axis=0)
    return float(np.fft.rfftfreq(size, period)[int(power.argmax())]) if power.any() else None
