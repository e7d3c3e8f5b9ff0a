"""Named tuples by their address: kernels pass a record of arrays on as one argument instead of as all its parts.

numba passes a tuple to a callee part by part, and an array as seven numbers or more: the workspace of a solver took 339
arguments. At each of some thousand calls the compiler wrote, read and optimised all of these, and machine code stored
them to the stack.
"""

from __future__ import annotations

import hashlib

from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AttributeTemplate
from numba.extending import (
    infer_getattr,
    lower_builtin,
    lower_getattr_generic,
    models,
    register_model,
    type_callable,
)


class RecordPointer(types.Type):
    """Type of the address of a named tuple in a caller's frame.

    Args:
        record: type of the named tuple.

    Attributes:
        fields: names of its fields.
        types: their types.
    """

    def __init__(self, record):
        self.record = record
        self.fields, self.types = record.fields, record.types
        # part of the name of each function that takes one: the full name of a record takes kilobytes
        which = hashlib.sha256(record.name.encode()).hexdigest()[:16]
        super().__init__(f"{record.instance_class.__name__}Pointer({which})")


@register_model(RecordPointer)
class _Model(models.OpaqueModel):
    """An address."""


def pointer_to(record):
    """Return a named tuple as it is; compiled: its address, valid until the calling kernel returns.

    A second call at the same place overwrites the first one's record: one parcel after another has the same address.
    An address stays an address.
    """
    return record


@type_callable(pointer_to)
def _type(_context):
    def typer(record):
        return record if isinstance(record, RecordPointer) else RecordPointer(record)

    return typer


@lower_builtin(pointer_to, RecordPointer)
def _same(_context, _builder, _signature, arguments):
    return arguments[0]


@lower_builtin(pointer_to, types.BaseNamedTuple)
def _stored(_context, builder, _signature, arguments):
    place = cgutils.alloca_once(builder, arguments[0].type)
    builder.store(arguments[0], place)
    return builder.bitcast(place, cgutils.voidptr_t)


@infer_getattr
class _Fields(AttributeTemplate):
    """Types of the fields: records in a record are addresses too."""

    key = RecordPointer

    def generic_resolve(self, pointer, name):
        """Return a field's type, or None if there is no such field."""
        if name not in pointer.fields:
            return None
        field = pointer.types[pointer.fields.index(name)]
        return RecordPointer(field) if isinstance(field, types.BaseNamedTuple) else field


@lower_getattr_generic(RecordPointer)
def _load(context, builder, pointer, address, name):
    record = context.get_value_type(pointer.record)
    index = pointer.fields.index(name)
    place = cgutils.gep_inbounds(builder, builder.bitcast(address, record.as_pointer()), 0, index)
    if isinstance(pointer.types[index], types.BaseNamedTuple):
        return builder.bitcast(place, cgutils.voidptr_t)
    return builder.load(place)
