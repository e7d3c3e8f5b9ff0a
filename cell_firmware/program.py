"""Base of all programs of cells: parameters, message type and checks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, final

import numpy as np
from numpy.typing import NDArray

from bus.lattice import Lattice
from bus.wire.message_type import each_all, leaves
from cell_firmware.specs import Spec

if TYPE_CHECKING:
    from cell_firmware.array_view import ArrayView


@final
@dataclass(frozen=True, slots=True)
class Theory:
    """A prediction for links that neither lose nor delay, and cells that all live and step at once.

    Attributes:
        law: The prediction in a line, with its source.
        factor: Factor of the slowest error from tick to tick: decays below 1, persists at 1, grows above 1. None for a
            protocol that finishes after a number of ticks, or without such a law.
        ticks: Upper bound on the ticks until the protocol finishes; None where it converges asymptotically.
        limit: Limit of ``Program.observable``, with a row a cell, in the lattice's order; None where theory predicts
            none.
    """

    law: str
    factor: float | None = None
    ticks: int | None = None
    limit: NDArray[Any] | None = None


class NoParameters(Spec):
    """Parameters of a program without any."""


class Program:
    """Base of ``Firmware`` and ``CellFirmware``, which add how the program is stepped.

    Args:
        parameters: An instance of ``Parameters``.
    """

    Parameters: ClassVar[type[Spec]] = NoParameters
    """What a scene may set in ``[cells.parameters]``."""
    message: ClassVar[np.dtype[Any] | None] = None
    """Little-endian structured type of a message between neighbours; None without messages."""
    random: ClassVar[tuple[str, ...]] = ()
    """Names of the random numbers that a cell is given in every tick; none are drawn without names."""
    kernels: ClassVar[str] = ""
    """Module of the kernels that step it, imported before processes of cells are forked; empty without kernels."""
    counters: ClassVar[Mapping[str, int]] = {}
    """Wrap of each counting variable: the number after the greatest. ``mdms check`` begins near the wrap, too."""
    observable: ClassVar[str | None] = None
    """Name of the state variable that is the protocol's field: a number or a vector a cell."""

    def __init__(self, parameters: Any) -> None:
        self.parameters = parameters

    def check(self, lattice: Lattice) -> None:
        """Refuse parameters that do not fit the array, before the run starts.

        Raises:
            ParametersError: They do not.
        """
        del lattice

    def check_geometry(self, lattice: Lattice, position_m: NDArray[np.float64], pitch_m: float) -> None:
        """Refuse parameters that do not fit the positions of the cells, before the run starts.

        Args:
            lattice: The cells.
            position_m: ``(n, 2)``, centre of each, m.
            pitch_m: Distance of neighbouring cells, m.

        Raises:
            ParametersError: They do not.
        """
        del lattice, position_m, pitch_m

    def required_effects(self) -> tuple[str, ...]:
        """Return the names of effects that the parameters depend on."""
        return ()

    def uses_camera(self) -> bool:
        """Whether cells with these parameters use camera frames, where the scene has a camera."""
        return False

    @property
    def author(self) -> Program:
        """The author's program, without an adapter around it."""
        return self

    def invariants(self, view: ArrayView) -> Iterable[tuple[str, Any]]:
        """Yield conditions that hold after every tick, each a rule in words and its truth.

        The truth is a boolean, or ``(a,)`` booleans, one for each running cell. Evaluated only where a run, a lab or a
        campaign checks.

        Args:
            view: Registers of all running cells.
        """
        del view
        return ()

    def eventually(self, view: ArrayView) -> Iterable[tuple[str, Any, int]]:
        """Yield conditions that come true within so many ticks: a rule in words, its truth, and the ticks.

        The ticks are counted from the first tick, from the last disturbance by a fault, and from the last tick in which
        the condition was true.

        Args:
            view: Registers of all running cells.
        """
        del view
        return ()

    def value_ranges(self) -> Mapping[str, tuple[float, float]]:
        """Return the range of values, by field of the messages, that cells of this program send over intact links.

        A field in a record has its name behind the record's: ``pose.x``. The range of a vector is that of each number.
        Fields without a range may have any value.
        """
        return {}

    def accepts(self, messages: NDArray[Any]) -> NDArray[np.bool_]:
        """Return which messages, of any shape, are plausible: floats are finite, or within ``value_ranges``.

        Called where faults may damage messages; a refused message is not delivered.
        """
        plausible, good = self.value_ranges(), np.ones(messages.shape, dtype=np.bool_)
        for leaf in leaves(messages.dtype):
            value = leaf.of(messages)
            if leaf.name in plausible:
                low, high = plausible[leaf.name]
                fits = ((value >= low) & (value <= high)) | ~leaf.used(messages)
            elif leaf.type.kind == "f":
                fits = np.isfinite(value)
            else:
                continue
            good &= each_all(fits, good.shape)
        return good

    def warnings(self, lattice: Lattice) -> tuple[str, ...]:
        """Return warnings of problems to expect on this array, a line each that names the visible symptom."""
        del lattice
        return ()

    def theory(self, lattice: Lattice) -> Theory | None:
        """Return the theoretical prediction for this array; None if there is none."""
        del lattice
        return None
