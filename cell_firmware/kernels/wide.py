"""Conversion of numbers in compiled steps to drafts of 64-bit integers, which keep what doesn't fit."""

from __future__ import annotations

from llvmlite import ir
from numba import from_dtype, types
from numba.core import cgutils
from numba.core.imputils import lower_cast
from numba.core.typeconv.rules import default_type_manager

from cell_firmware.message_drafts import WIDE

_NUMBERS = (
    types.boolean,
    *(types.int8, types.int16, types.int32, types.int64),
    *(types.uint8, types.uint16, types.uint32, types.uint64),
    *(types.float32, types.float64),
)
_DRAFTS = tuple(from_dtype(kind) for kind in WIDE.values())

for _draft in _DRAFTS:
    for _number in _NUMBERS:
        default_type_manager.set_unsafe_convert(_number, _draft)


@lower_cast(types.Number, types.Record)
@lower_cast(types.Boolean, types.Record)
def number_to_draft(context, builder, number, draft, value):
    """Convert a number to a record of ``WIDE``, as numba converts whatever is written to a field of another type.

    Args:
        context: Of the code generation.
        builder: Of instructions.
        number: Type of the number.
        draft: Type of the record.
        value: The number.
    """
    if draft not in _DRAFTS:
        raise NotImplementedError(f"a number written to a record of {', '.join(draft.fields)}")
    whole = draft.typeof("bits")
    if isinstance(number, types.Float):
        bits, fits = _of_float(context, builder, number, whole, value)
    else:
        bits = context.cast(builder, value, number, whole)
        fits = cgutils.true_bit
        if isinstance(number, types.Integer) and number.bitwidth == whole.bitwidth:
            if number.signed != whole.signed:
                fits = builder.icmp_signed(">=", value, ir.Constant(value.type, 0))
        elif isinstance(number, types.Integer) and number.signed and not whole.signed:
            fits = builder.icmp_signed(">=", value, ir.Constant(value.type, 0))
    given = context.cast(builder, value, number, types.float64)
    zero = ir.Constant(given.type, 0.0)
    record = cgutils.alloca_once(builder, context.get_data_type(draft))
    for name, member in (("bits", bits), ("given", builder.select(fits, zero, given))):
        kind = draft.typeof(name)
        place = cgutils.get_record_member(builder, record, draft.offset(name), context.get_data_type(kind))
        context.pack_value(builder, kind, member, place)
    return record


def _of_float(context, builder, number, whole, value):
    """Return the integer of a float, 0 for one that doesn't fit, and whether it fits."""
    real = context.cast(builder, value, number, types.float64)
    least = -(2.0 ** (whole.bitwidth - 1)) if whole.signed else 0.0
    beyond = 2.0 ** (whole.bitwidth - 1 if whole.signed else whole.bitwidth)
    in_range = builder.and_(
        builder.fcmp_ordered(">=", real, ir.Constant(real.type, least)),
        builder.fcmp_ordered("<", real, ir.Constant(real.type, beyond)),
    )
    # a conversion of what is out of range has no defined result
    safe = builder.select(in_range, real, ir.Constant(real.type, 0.0))
    bits = context.cast(builder, safe, types.float64, whole)
    back = context.cast(builder, bits, whole, types.float64)
    fits = builder.select(in_range, builder.fcmp_ordered("==", back, real), cgutils.false_bit)
    return builder.select(fits, bits, ir.Constant(bits.type, 0)), fits
