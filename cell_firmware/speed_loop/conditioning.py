"""Anti-windup by conditioning: in saturation the integral comes to what would hold the limit at the speed there is.

Where the loop asks for more than the supply it takes itself to follow the reference w with which it would have asked
for just the limit, and integrates the error to that (Hanus, Kinnaert and Henrotte, Automatica 23, 1987). With
``K = kp + kf + ki T`` and the limit u, ``w = r + (u - wanted) / K``, and what becomes of the integral does not depend
on the reference r any more::

    I + ki T (w - V) = I + b (u - kf V - I)        b = ki T / K

This is tracking (Åström and Hägglund) with a share b in [0, 1] that leaves nothing over: it ends where a steady loop at
that voltage and speed has its integral, so that what follows is the response of the loop without limits.
"""

from __future__ import annotations


def share(kp: float, ki_t: float, feed_forward: float) -> float:
    """By how much of its way the integral moves each saturated period, 0 to 1; 0 without an integral.

    Args:
        kp: Proportional gain, >= 0.
        ki_t: Integral gain times the period, >= 0, in the same unit.
        feed_forward: Likewise.
    """
    return ki_t / (kp + feed_forward + ki_t) if ki_t else 0.0
