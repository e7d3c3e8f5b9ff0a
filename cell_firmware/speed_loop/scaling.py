"""Scaling of the integer speed loop: gains as words and shifts, and widths that are checked before anything runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple, TypeVar, final

import numpy as np
from numpy.typing import NDArray

from cell_firmware.errors import SettingError
from cell_firmware.specs import SpeedLoopSpec
from cell_firmware.speed_loop.output import share
from cell_firmware.speed_loop.sensing import FRACTION_BITS, LARGEST_WORD, IntegerTachometer

OUTPUT_BITS: Final = 12
"""Of an output and of an integral: Q12, 4096ths of a level."""
IDEAL_LEVELS: Final = 2**11
"""Levels of the supply where no PWM has levels of its own."""
LARGEST_SWING: Final = 2**29
"""Q12: more than from the supply one way to the supply the other, which is all that an integral can have to go."""
_LOW_BITS: Final = 14
_LARGEST_SUM: Final = 2**31 - 1
_MOST_SHIFT: Final = 30
_FIELDS: Final = ("kp_v_per_m_s", "ki_v_per_m", "feed_forward_v_per_m_s")

_Number = TypeVar("_Number", int, NDArray[np.int32])


@final
@dataclass(frozen=True, slots=True)
class Gain:
    """A factor from Q4 to Q12, or a share of what is in Q12: ``word / 2^shift``.

    Attributes:
        word: 15 bits, so that its product with a 16-bit speed fits 32.
        shift: To the right after the product, rounding to the nearest, ties up; to the left where negative.
    """

    word: int
    shift: int

    @classmethod
    def nearest(cls, factor: float) -> Gain:
        """The nearest to a factor >= 0 with all bits of the word that the shift allows: within 1 in 32,768."""
        if factor == 0.0:
            return cls(0, 0)
        significand, exponent = np.frexp(factor)
        shift = min(15 - int(exponent), _MOST_SHIFT)
        word = round(float(np.ldexp(significand, int(exponent) + shift)))
        return cls(word, shift) if word <= LARGEST_WORD else cls(word >> 1, shift - 1)

    @property
    def factor(self) -> float:
        """As realised."""
        return float(np.ldexp(self.word, -self.shift))

    def times(self, value: _Number) -> _Number:
        """The product with a number in Q4 (at most 16 bits) or an int32 array of such; in Q12."""
        if self.shift <= 0:
            return (value * self.word) << -self.shift
        return (value * self.word + (1 << (self.shift - 1))) >> self.shift

    def away_from_zero(self, value: NDArray[np.int32]) -> NDArray[np.int32]:
        """The product of a share <= 1 with numbers up to `LARGEST_SWING` either way.

        In 32 bits like all else: the word by the upper bits and by the lower 14. Rounded away from zero, which is no
        further than the number itself, so that repeating it leaves nothing.
        """
        magnitude = np.abs(value)
        low = (magnitude & ((1 << _LOW_BITS) - 1)) * self.word
        product = (magnitude >> _LOW_BITS) * self.word + ((low + ((1 << _LOW_BITS) - 1)) >> _LOW_BITS)
        left = max(self.shift - _LOW_BITS, 0)  # less only where the word is 0
        moved = (product + ((1 << left) - 1)) >> left
        return np.where(value < 0, -moved, moved)


class Realised(NamedTuple):
    """A gain as requested and as realised.

    Attributes:
        name: Of the field.
        requested: Its value.
        realised: What the integers make of it, in the same unit.
        word: Of the gain.
        shift: Of the gain.
    """

    name: str
    requested: float
    realised: float
    word: int
    shift: int


@final
class Scaling:
    """A loop's gains in integers: speeds in Q4 of a reading's unit, outputs in Q12 of a level.

    All sums fit 32 bits, whatever the inputs. Errors are limited to what saturates the output against any integral and
    feed-forward, so that limiting them changes nothing; speeds beyond the tachometer's range are taken as that.

    Args:
        spec: Gains.
        period_s: The control period, s.
        supply_v: What the output stage can give, V.
        levels: Into how many levels it is divided.
        tachometer: What measures the speed.

    Attributes:
        kp, ki, feed_forward: Gains.
        share: Of its way that an integral moves in a saturated period, a factor from Q12 to Q12.
        reference_limit: Of the reference, either way, Q4.
        error_limit: Of the error.
        output_limit: Of output and integral, Q12: the supply.
        volts_per_step: What 1 in Q12 stands for, V.

    Raises:
        SettingError: A gain does not fit; names it.
    """

    def __init__(
        self,
        spec: SpeedLoopSpec,
        period_s: float,
        supply_v: float,
        levels: int,
        tachometer: IntegerTachometer,
    ) -> None:
        self.reference_limit = tachometer.largest << (FRACTION_BITS - tachometer.fraction_bits)
        self.output_limit = levels << OUTPUT_BITS
        self.volts_per_step = supply_v / self.output_limit
        self._requested = tuple(float(getattr(spec, field)) for field in _FIELDS)
        unit = tachometer.step_m_s / self.volts_per_step
        self._units = (unit, unit * period_s, unit)
        gains = [self._gain(i) for i in range(len(_FIELDS))]
        self.kp, self.ki, self.feed_forward = gains
        self.share = Gain.nearest(share(self.kp.factor, self.ki.factor, self.feed_forward.factor))
        self.error_limit = self._error_limit()
        self._check_sum()

    def _gain(self, i: int) -> Gain:
        factor = self._requested[i] * self._units[i]
        if factor > _LARGEST_SUM:
            self._refuse(i, "too large: not even the least error times it fits 32 bits")
        gain = Gain.nearest(factor)
        if factor and not gain.times(self.reference_limit):
            self._refuse(i, "so small that it rounds to nothing")
        return gain

    def _error_limit(self) -> int:
        """The least error by which the proportional term alone saturates the output, against all else."""
        against = 2 * self.output_limit + self.feed_forward.times(self.reference_limit) + 1
        most = min(2 * self.reference_limit, LARGEST_WORD)
        if self.kp.times(most) < against:
            return most
        return -(-(against << max(self.kp.shift, 0)) // (self.kp.word << max(-self.kp.shift, 0)))

    def _check_sum(self) -> None:
        """The largest sum of a step, term by term."""
        terms = (
            self.kp.times(self.error_limit),
            self.ki.times(self.error_limit),
            self.feed_forward.times(self.reference_limit),
        )
        total = sum(terms) + self.output_limit
        if total > _LARGEST_SUM:
            worst = terms.index(max(terms))
            self._refuse(
                worst, f"too large: a sum of the loop takes {total.bit_length() + 1} bits, and there are 32"
            )

    def _refuse(self, i: int, why: str) -> None:
        raise SettingError(("cells", "speed_loop", _FIELDS[i]), self._requested[i], f"fixed point: {why}")

    def realised(self) -> tuple[Realised, ...]:
        """Every gain as requested and as realised."""
        gains = (self.kp, self.ki, self.feed_forward)
        return tuple(
            Realised(name, requested, gain.factor / unit, gain.word, gain.shift)
            for name, requested, gain, unit in zip(_FIELDS, self._requested, gains, self._units, strict=True)
        )

    @property
    def rounding_v(self) -> float:
        """The most by which rounded products move the output of one step, V: half a step each that is shifted right."""
        rounded = sum(gain.shift > 0 for gain in (self.kp, self.ki, self.feed_forward))
        return 0.5 * rounded * self.volts_per_step
