"""Residuals of a recorded motion: the force and the voltage that the model does not explain."""

from __future__ import annotations

from functools import cache, lru_cache
from math import sqrt

import numpy as np

from s2r_emps.laws import drive_force, encoder_error, lacking_force, smooth
from s2r_emps.noise import FloatArray
from s2r_emps.physics import KP, KV, RATE, Physics
from s2r_spec.errors import TraceError, one_of
from s2r_spec.trace import Trace

CUTOFF = 40.0
"""Cut-off of the filter before two derivatives [Hz]; the loop's own motion ends at about 20 Hz."""
SATURATES = 0.8
"""Tolerance: part of its largest voltage from which on a drive may be saturated, whatever its limit is."""
EDGE = 50
"""Samples cut off at either end, where the filter is not valid: two periods of its cut-off."""


def residuals(trace: Trace, physics: Physics, stiffness: float = 1.0) -> Trace:
    """Return ``force`` [N], from inverse dynamics, and ``controller`` [V], from the control law.

    ``force`` is the force that the motion needs on top of the model's forces, positive if it pushes the carriage
    forwards. ``controller`` is the logged voltage minus that of the control law on the logged positions; it is zero
    while the drive is off.

    Args:
        trace: trace at 1 kHz with ``q`` and ``u`` for the first, and also ``q_ref`` for the second.
        physics: the model, with the test's payload in its mass.
        stiffness: factor on the controller's stiffness, as in :func:`s2r_emps.axis.simulate`.

    Raises:
        TraceError: a channel is missing, or the samples are too few or not 1 ms apart.
    """
    if not {"q", "u"} <= set(trace.channels):
        raise TraceError(
            f"residuals need q and u (and q_ref for the controller's), but the trace has {one_of(trace.channels)}"
        )
    if not is_even(trace):
        raise TraceError(f"residuals need a trace of more than {3 * EDGE} samples, 1 ms apart")
    inner = slice(EDGE, -EDGE)
    channels = {"force": _force(trace, physics)[inner]}
    units = {"force": "N"}
    if "q_ref" in trace.channels:
        channels["controller"] = _controller(trace, physics, stiffness)[inner]
        units["controller"] = "V"
    parts = {"force": ["carriage"], "controller": ["controller"]}
    return Trace(trace.times[inner], channels, units, {"parts": {name: parts[name] for name in channels}})


@lru_cache(maxsize=2)
def is_even(trace: Trace) -> bool:
    """Return whether a trace has more samples than the filters need, 1 ms apart."""
    steps = np.diff(trace.times)
    return len(trace) > 3 * EDGE and bool(np.allclose(steps, 1 / RATE, rtol=0, atol=0.01 / RATE))


def _force(trace: Trace, physics: Physics) -> FloatArray:
    q, v, speeds_up = _motion(trace, _with_constants(physics, _ENCODER))
    force = _drive_force(trace, _with_constants(physics, _DRIVE))
    return lacking_force(q, v, speeds_up, force, physics)


# A diagnosis computes the residuals of one trace with many effects, and most effects leave the motion or the drive
# unchanged.


@lru_cache(maxsize=4)
def _motion(trace: Trace, physics: Physics) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return (n,) filtered position [m], speed [m/s] and acceleration [m/s²]."""
    measured = trace["q"]
    q = _smooth(measured - encoder_error(measured, physics))
    v = np.gradient(q, 1 / RATE)
    return q, v, np.gradient(v, 1 / RATE)


@lru_cache(maxsize=4)
def _drive_force(trace: Trace, physics: Physics) -> FloatArray:
    """Return (n,) the motor's force [N], filtered like the motion."""
    q, _, _ = _motion(trace, _with_constants(physics, _ENCODER))
    return _smooth(drive_force(trace["u"], q, physics))


_ENCODER = frozenset({"encoder_ripple", "encoder_phase"})
_DRIVE = _ENCODER | {"gain", "delay", "lag", "sag", "ripple", "ripple_phase"}


def _with_constants(physics: Physics, names: frozenset[str]) -> Physics:
    """Return the nominal axis with these constants of another one, so that the cache ignores the other constants."""
    return Physics(**{name: getattr(physics, name) for name in names})


def _controller(trace: Trace, physics: Physics, stiffness: float) -> FloatArray:
    u = trace["u"]
    return np.where(u == 0, 0.0, u - control_law(trace, physics, stiffness))


def control_law(trace: Trace, physics: Physics, stiffness: float = 1.0) -> FloatArray:
    """Return (n,) the voltage [V] of the control law on the logged ``q`` and ``q_ref``, after saturation."""
    voltage: FloatArray = np.clip(
        _law(trace, speed(trace, physics), stiffness), -physics.voltage, physics.voltage
    )
    return voltage


def _law(trace: Trace, fed_back: FloatArray, stiffness: float = 1.0) -> FloatArray:
    root = sqrt(stiffness)
    return np.asarray(KV * root * (KP * root * (trace["q_ref"] - trace["q"]) - fed_back))


def speed(trace: Trace, physics: Physics) -> FloatArray:
    """Return (n,) the speed [m/s] that the drive feeds back, from the logged ``q``."""
    fed_back = np.diff(trace["q"], prepend=2 * trace["q"][0] - trace["q"][1]) * RATE
    if physics.speed_filter:
        return np.asarray(smooth(fed_back, physics.speed_filter, float(fed_back[0])))
    return fed_back


def unsaturated_voltage(trace: Trace, physics: Physics) -> FloatArray:
    """Return (n,) the voltage [V] of the control law before saturation, on the logged ``v`` where there is one.

    NaN where the drive is off, and where it may be saturated: the law asks for more than the logged voltage, which is
    near its largest.
    """
    fed_back, u = trace.channels.get("v"), trace["u"]
    voltage = _law(trace, speed(trace, physics) if fed_back is None else fed_back)
    if fed_back is None:
        voltage[0] = np.nan
    largest = np.abs(u) >= SATURATES * np.nanmax(np.abs(u), initial=0.0)
    beyond = largest & (np.sign(u) * voltage >= np.abs(u))
    return np.where((u == 0.0) | beyond, np.nan, voltage)


def _smooth(values: FloatArray) -> FloatArray:
    """Return values filtered by a second-order Butterworth filter, forwards and backwards, so without phase lag.

    The filter acts in the frequency domain, with odd reflection at both ends, which is many times as fast as two passes
    in time.
    """
    from scipy.fft import irfft, next_fast_len, rfft  # here, because a rollout needs no scipy

    pad = 3 * EDGE
    before, after = 2 * values[0] - values[pad:0:-1], 2 * values[-1] - values[-2 : -pad - 2 : -1]
    size = next_fast_len(values.size + 2 * pad, real=True)
    filled = np.full(size - values.size - 2 * pad, after[-1])
    padded = np.concatenate([before, values, after, filled])
    return np.asarray(irfft(rfft(padded) * _gain(size), size)[pad : pad + values.size])


@cache
def _gain(size: int) -> FloatArray:
    # By the bilinear transform, which ends at half the sampling rate; squared, for the two passes.
    turn = np.minimum(np.pi * np.arange(size // 2 + 1) / size, 0.499999 * np.pi)
    return np.asarray(1.0 / (1.0 + (np.tan(turn) / np.tan(np.pi * CUTOFF / RATE)) ** 4))
