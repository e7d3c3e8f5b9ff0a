"""Programs in scalar form: one compiled step of one cell, on records of state."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import Any, ClassVar, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from cell_firmware.firmware import Firmware, Inputs, Outbox, Outputs, State
from cell_firmware.message_drafts import plain_drafts


class ScalarKernels(Protocol):
    """Module of a program in scalar form.

    Attributes:
        PARAMETERS: Type of the record of its constants.
        STATE: Type of the record of a cell's state; truth values are bytes.
        MESSAGE: Type of its messages.
        tick: ``cell_firmware.kernels.shard.run_tick`` of the program.
        rows: ``cell_firmware.kernels.shard.run_rows`` of the program.
    """

    PARAMETERS: np.dtype[Any]
    STATE: np.dtype[Any]
    MESSAGE: np.dtype[Any]
    tick: Any
    rows: Any


class ScalarFirmware(Firmware):
    """Firmware whose step is a kernel of one cell, in the module ``kernels``.

    A shard's tick is then a single call. ``init`` returns arrays, named as the fields of the module's ``STATE``.

    Attributes:
        is_brief: Whether a step always returns soon.
    """

    form: ClassVar[str] = "compiled"
    refuses_misfits: ClassVar[bool] = True  # messages are written as drafts of its own
    is_brief: ClassVar[bool] = True

    def constants(self) -> Mapping[str, Any]:
        """Return the values of the record of constants, by field; none: they are zero."""
        return {}

    def is_compiled(self) -> bool:
        """Whether steps are compiled, not run as Python."""
        return True

    def scalar_kernels(self) -> ScalarKernels:
        """Return the program's kernels; compiles, or loads them from disk."""
        return cast(ScalarKernels, import_module(self.kernels))

    def run_rows(
        self, constants: NDArray[Any], records: NDArray[Any], given: NDArray[Any], done: NDArray[Any]
    ) -> None:
        """Step cells, row by row.

        Args:
            constants: One record.
            records: ``(n,)`` of states, changed in place.
            given: ``(n,)`` of ``inputs_type``.
            done: ``(n,)`` of ``outputs_type`` that are not compiled, as before a step; is filled.
        """
        self.run_compiled(constants, records, given, done)

    def run_compiled(
        self, constants: NDArray[Any], records: NDArray[Any], given: NDArray[Any], done: NDArray[Any]
    ) -> None:
        """Step cells by the compiled step; see ``run_rows``."""
        from cell_firmware.kernels.program import outputs_type

        module = self.scalar_kernels()
        outputs = np.zeros(len(done), dtype=outputs_type(module.MESSAGE))
        outputs["served"] = done["served"]
        module.rows(constants, records, given, outputs)
        for name in ("speed_m_s", "served", "sent"):
            done[name] = outputs[name]
        done["message"] = plain_drafts(outputs["message"], module.MESSAGE)

    def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
        """One control period of every cell, for boards and faults that are stepped on arrays."""
        from cell_firmware.kernels.program import inputs_type, outputs_type

        module = self.scalar_kernels()
        n = len(inputs.presence)
        records, after = state_records(module.STATE, state, n)
        given = np.zeros(n, dtype=inputs_type(module.MESSAGE, self.random))
        given["sensors"] = inputs.presence.shape[1]
        given["presence"][:, : inputs.presence.shape[1]] = inputs.presence
        if inputs.level is not None:
            given["level"][:, : inputs.level.shape[1]] = inputs.level
        if inputs.label is not None:
            given["label"] = inputs.label
        if inputs.inbox is not None:
            given["received"], given["message"] = inputs.inbox.received, inputs.inbox.message
        for name in self.random:
            given["random"][name] = inputs.random[name]
        done = np.zeros(n, dtype=outputs_type(module.MESSAGE, compiled=False))
        done["served"] = 1
        self.run_rows(parameters_record(module.PARAMETERS, self.constants()), records, given, done)
        outbox, misfits = None, dict[int, str]()
        if self.message is not None:
            sent, drafts = done["sent"].astype(np.bool_), np.ascontiguousarray(done["message"])
            drafts[~sent] = np.zeros((), dtype=drafts.dtype)
            outbox, misfits = Outbox(sent, drafts).settled(module.MESSAGE)
            for row in np.flatnonzero(~np.isfinite(done["speed_m_s"]).all(axis=1)).tolist():
                misfits.pop(row, None)  # that is the failure
        served = done["served"].astype(np.bool_)
        return after, Outputs(done["speed_m_s"].copy(), outbox, misfits or None, served)


def parameters_record(kind: np.dtype[Any], constants: Mapping[str, Any]) -> NDArray[Any]:
    """Return the constants of a program as one record, ``(1,)``."""
    record = np.zeros(1, dtype=kind)
    for name, value in constants.items():
        record[name] = value
    return record


def constants_problem(kind: np.dtype[Any], constants: object) -> str | None:
    """Return why values are no record of constants: missing and unknown fields, and values that fields would cut.

    Args:
        kind: Type of the record.
        constants: What ``constants`` of a program returned.
    """
    fields = kind.names or ()
    if not isinstance(constants, Mapping):
        return f"must return a dict with the fields {', '.join(fields)}, not {type(constants).__name__}"
    values: Mapping[str, Any] = constants  # pyright: ignore[reportUnknownVariableType]
    if set(values) != set(fields):
        return f"must have the fields {', '.join(fields)}; {_other_names(fields, values)}"
    record = np.zeros((), dtype=kind)
    for name in fields:
        try:
            with np.errstate(all="ignore"):
                record[name] = values[name]
            numbers = np.asarray(values[name]).dtype.kind in "fiub"
        except (TypeError, ValueError, OverflowError):
            numbers = False
        base = (kind[name].subdtype or (kind[name],))[0]
        if base.names is None and not numbers:
            return f"{name} is {values[name]!r}: must be {kind[name]}"
        if base.kind in "iub" and not np.array_equal(record[name], values[name]):
            return f"{name} is {values[name]!r}: {kind[name]} would cut it to {record[name].tolist()}"
    return None


def state_problem(kind: np.dtype[Any], state: State) -> str | None:
    """Return why initial arrays are no state of records: missing and unknown fields, and values that fields would cut.

    Args:
        kind: Type of the records.
        state: Arrays by name, a row a cell.
    """
    fields = kind.names or ()
    if set(state) != set(fields):
        return f"state must have the fields {', '.join(fields)}; {_other_names(fields, state)}"
    for name in fields:
        base, shape = kind[name].subdtype or (kind[name], ())
        values = state[name]
        if values.shape[1:] != shape:
            return f"state[{name!r}] has the shape {values.shape}: must be {(len(values), *shape)}"
        if base.names is None and values.dtype != base:
            with np.errstate(all="ignore"):
                kept = values.astype(base)
            if base.kind in "iub" and not (kept == values).all():
                return f"state[{name!r}] has values that a field of {base} can't hold"
    return None


def state_records(kind: np.dtype[Any], state: State, n: int) -> tuple[NDArray[Any], dict[str, NDArray[Any]]]:
    """Return the state of n cells as records, ``(n,)``, and the same memory as arrays by name."""
    records, arrays = np.zeros(n, dtype=kind), dict[str, NDArray[Any]]()
    for name, values in state.items():
        field = records[name]
        arrays[name] = field.view(np.bool_) if values.dtype == np.bool_ else field
        arrays[name][...] = values
    return records, arrays


def _other_names(fields: Sequence[str], given: Mapping[str, Any]) -> str:
    missing = [name for name in fields if name not in given]
    unknown = [name for name in given if name not in fields]
    return "; ".join(
        f"{what} {', '.join(names)}" for what, names in (("missing", missing), ("unknown", unknown)) if names
    )
