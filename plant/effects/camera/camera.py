"""Camera frames of parcels' poses (effect ``camera``): taken at ticks, delivered after a latency."""

from __future__ import annotations

from collections import deque
from fractions import Fraction
from typing import ClassVar, final

import numpy as np
from numpy.typing import NDArray

from bus.random_streams import rng
from bus.sensors import CameraFrame
from bus.state import StateFields
from plant.effects.camera.spec import CameraSpec
from plant.wheels import Floats


@final
class Camera:
    """Camera that takes frames of the parcels' poses and selects the frame that cells receive in a tick.

    Frame j is taken at the first tick that does not begin before ``j period_s``, at most one a tick, and delivered in
    the first tick that does not begin before ``latency_s`` after that. Angles are in [-pi, pi): frames don't show a
    parcel's number of turns. Noise is Gaussian and independent for each parcel and frame.

    Args:
        spec: frame rate, latency and noise.
        tick_ns: duration of a tick, ns.
        seed: seed of the scene.
        later: additional delay of all frames in ticks: 1 where cells receive in a tick the readings of the previous
            tick, so that no frame arrives before it exists.
    """

    state_fields: ClassVar[StateFields] = StateFields(
        "_draw", "_next_ns", "_in_flight", records=(CameraFrame,)
    )

    def __init__(self, spec: CameraSpec, tick_ns: int, seed: int, later: int = 0) -> None:
        self._tick_ns = tick_ns
        self._period_ns = _nanoseconds(spec.period_s)
        self._delay = -(-_nanoseconds(spec.latency_s) // tick_ns) + later
        self._spread = np.array([spec.position_noise_m, spec.position_noise_m, spec.angle_noise_rad])
        self._draw = rng(seed, "camera.noise")
        self._next_ns = Fraction(0)
        self._in_flight: deque[tuple[int, CameraFrame]] = deque()

    def capture(self, tick: int, state: Floats, there: NDArray[np.int64]) -> CameraFrame | None:
        """Take a frame if due and return the frame that cells receive in this tick; call in every tick, in order.

        Args:
            tick: current tick.
            state: states of all parcels at the start of the tick, ``(m, 6)``.
            there: indices of visible parcels, ascending.
        """
        now_ns = tick * self._tick_ns
        if now_ns >= self._next_ns:
            taken = now_ns // self._period_ns
            self._next_ns = (taken + 1) * self._period_ns
            self._in_flight.append((tick + self._delay, self._picture(state, there)))
        if self._in_flight and self._in_flight[0][0] == tick:
            return self._in_flight.popleft()[1]
        return None

    def _picture(self, state: Floats, there: NDArray[np.int64]) -> CameraFrame:
        # drawn for all: who comes and goes changes nothing for the others
        off = self._draw.standard_normal((len(state), 3)) * self._spread
        pose = (state[:, :3] + off)[there]
        pose[:, 2] -= 2.0 * np.pi * np.floor((pose[:, 2] + np.pi) / (2.0 * np.pi))
        return CameraFrame(there.copy(), pose)


def _nanoseconds(span_s: float) -> Fraction:
    """As it was written."""
    return Fraction(repr(span_s)) * 1_000_000_000
